# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.lidar.scans.poses import Path
from ceiling_dso_ros.lidar.scans.wheel_motion import wheel_motions
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.robot import WheelErrors
from ceiling_dso_ros.simulation.sensors.measurements import stamp_ns

EXACT = WheelErrors(0.0, 0.0, 0.0, 0.0, 0.0)


def motions(samples, robot=None):
    said = []
    return wheel_motions(samples, robot, said.append), said


def test_dead_reckoning_is_the_motion():
    recording = SimulatedRecording(SimulationConfig("loops", duration_s=12.0, wheels=EXACT))
    found, said = motions(recording.wheels, recording.robot)
    times_s = np.array([2.0, 5.03, 9.51])
    stamps = np.array([stamp_ns(time_s) for time_s in times_s])
    truth = Path(stamps, recording.simulation.robot.motion.poses(times_s))
    np.testing.assert_allclose(found.between(stamps[:-1], stamps[1:]), [*map(tuple, _between(truth))], atol=0.01)
    assert said == []
    assert found.covers(stamps[:-1], stamps[1:]).all()
    assert not found.covers(stamps[:1] - 10**11, stamps[:1])[0]


def _between(path):
    from ceiling_dso_ros.lidar.scans.poses import between

    return between(path.poses[:-1], path.poses[1:])


def test_it_is_less_sure_the_further_it_goes():
    recording = SimulatedRecording(SimulationConfig("loops", duration_s=12.0))
    found, _ = motions(recording.wheels, recording.robot)
    start = np.full(3, stamp_ns(4.0))
    ends = np.array([stamp_ns(time_s) for time_s in (4.1, 5.0, 9.0)])
    sigmas = found.sigmas(start, ends)
    assert (np.diff(sigmas, axis=0) > 0).all()
    np.testing.assert_allclose(found.sigmas(ends, start), sigmas)


def test_a_gap_of_the_samples_is_not_covered():
    recording = SimulatedRecording(SimulationConfig("loops", duration_s=8.0))
    samples = recording.wheels
    kept = (samples.stamps_ns < stamp_ns(4.0)) | (samples.stamps_ns > stamp_ns(6.0))
    found, _ = motions(WheelSamples(samples.unit, samples.stamps_ns[kept], samples.readings[kept]), recording.robot)
    starts = np.array([stamp_ns(3.0), stamp_ns(3.0), stamp_ns(6.5)])
    ends = np.array([stamp_ns(3.5), stamp_ns(6.5), stamp_ns(7.0)])
    assert found.covers(starts, ends).tolist() == [True, False, True]


def test_poses_need_no_robot_and_ticks_do():
    samples = WheelSamples(WheelUnit.POSES, np.array([0, 10**9]), np.array([[0.0, 0, 0], [1.0, 0.5, 0.2]]))
    found, said = motions(samples)
    assert said == []
    np.testing.assert_allclose(found.between(np.array([0]), np.array([10**9])), [[1.0, 0.5, 0.2]], atol=1e-12)
    ticks = WheelSamples(WheelUnit.TICKS, np.array([0, 10**9]), np.zeros((2, 2), np.int64))
    found, said = motions(ticks)
    assert found is None
    assert len(said) == 1 and "--robot robot.yaml" in said[0]


def test_one_sample_is_no_motion():
    found, said = motions(WheelSamples(WheelUnit.POSES, np.array([0]), np.zeros((1, 3))))
    assert found is None
    assert "only one sample" in said[0]


@pytest.mark.parametrize("stamp", [0, 10**9])
def test_at_its_ends_it_is_known(stamp):
    found, _ = motions(WheelSamples(WheelUnit.POSES, np.array([0, 10**9]), np.zeros((2, 3))))
    assert found.covers(np.array([stamp]), np.array([stamp]))[0]
