# SPDX-License-Identifier: BSD-3-Clause
import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.recording import RobotDescription, WheelSamples, WheelUnit
from ceiling_dso_ros.io.trajectory import read_tum, write_tum
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback, robot_model

HEIGHT_M, SPEED_M_S, BEGIN_NS = 4.0, 0.8, 1_732_800_000_123_456_789
ROBOT = RobotDescription(4096.0, (0.1, 0.1), 0.5, np.eye(4))


def wheels(seconds):
    """Straight on."""
    ages_ns = 20_000_000 * np.arange(int(seconds * 50))
    turned = SPEED_M_S * ages_ns * 1e-9 / (2 * np.pi * 0.1) * 4096
    return WheelSamples(WheelUnit.TICKS, BEGIN_NS + ages_ns, np.column_stack([turned, turned]).astype(np.int64))


def statuses(seconds):
    """A keyframe every fifth of a second."""
    window = []
    for key in range(int(seconds * 5)):
        T = np.eye(4)
        T[0, 3] = SPEED_M_S * key / 5 / HEIGHT_M
        stamp_ns = BEGIN_NS + key * 200_000_000
        window = [*window, KeyframeEstimate(key, stamp_ns, 0, T, (0.0, 0.0), leaves=False)][-7:]
        yield OdometryStatus(
            stamp_ns, TrackingState.TRACKING, 0, T, np.eye(6), True, key, np.eye(4), keyframes=tuple(window)
        )


@pytest.fixture
def playback():
    result = FusionPlayback(wheels(10.0), robot_model(ROBOT))
    for status in statuses(9.0):
        result.add(status)
    result.finish()
    return result


def write(playback, folder):
    for name, make in playback.files().items():
        write_tum(folder / name, make())


@pytest.mark.parametrize("missing", ["wheels", "robot"])
def test_needs_wheels_and_the_robots_dimensions(missing):
    recording = SimpleNamespace(path="drive.bag", wheels=wheels(1.0), robot=ROBOT)
    assert FusionPlayback.of(recording).estimator.robot.wheel_base_m == 0.5
    setattr(recording, missing, None)
    with pytest.raises(InputError, match="needs wheels"):
        FusionPlayback.of(recording)


def test_writes_base_link_at_every_wheel_sample_and_at_every_keyframe(playback, tmp_path):
    write(playback, tmp_path)
    stamps = wheels(10.0).stamps_ns[1:]
    for name in ("wheel.tum", "fused.tum"):
        trajectory = read_tum(tmp_path / name)
        np.testing.assert_array_equal(trajectory.stamps_ns, stamps)
        np.testing.assert_allclose(trajectory.positions[-1], [SPEED_M_S * 9.98, 0.0, 0.0], atol=0.02)
    smoothed = read_tum(tmp_path / "fused_smoothed.tum")
    np.testing.assert_array_equal(smoothed.stamps_ns, BEGIN_NS + np.arange(45) * 200_000_000)


def test_the_summary_tells_scale_and_changes(playback):
    summary = playback.summary()
    assert summary["scale"]["value"] == pytest.approx(HEIGHT_M, rel=0.005)
    assert summary["scale"]["converged"]
    assert summary["slips"] == []
    changes = summary["fusion"]
    assert [change["state"] for change in changes] == ["not scaled", "converged", "degraded"]
    assert changes[-1]["reasons"][0].startswith("camera: silent")  # the wheels go on for a second longer


def test_predicts_the_motion_in_the_unit_of_the_segment():
    playback = FusionPlayback(wheels(10.0), robot_model(ROBOT))
    known = list(statuses(9.0))
    for status in known:
        playback.add(status)
    T_last_camera = playback.predicted_motion(known[-1], known[-1].stamp_ns + 300_000_000).T_start_end
    np.testing.assert_allclose(T_last_camera[:3, 3], [0.3 * SPEED_M_S / HEIGHT_M, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(T_last_camera[:3, :3], np.eye(3), atol=1e-3)


@pytest.mark.parametrize("change", [{"state": TrackingState.LOST}, {"segment": 1}])
def test_predicts_metres_after_a_loss_and_before_the_segment_has_a_scale(change):
    playback = FusionPlayback(wheels(10.0), robot_model(ROBOT))
    known = list(statuses(5.0))
    for status in known:
        playback.add(status)
    last = dataclasses.replace(known[-1], **change)
    motion = playback.predicted_motion(last, last.stamp_ns + 100_000_000)
    assert motion.metric
    np.testing.assert_allclose(motion.T_start_end[:3, 3], [0.1 * SPEED_M_S, 0.0, 0.0], atol=1e-3)


def test_without_images_there_are_wheels_alone(tmp_path):
    playback = FusionPlayback(wheels(2.0), robot_model(ROBOT))
    playback.finish()
    write(playback, tmp_path)
    assert playback.summary()["scale"] == {"value": None, "sigma": None, "converged": False}
    assert (tmp_path / "fused.tum").read_text() == (tmp_path / "wheel.tum").read_text()
    assert (tmp_path / "fused_smoothed.tum").read_text() == ""


def test_knows_of_a_late_camera():
    assert robot_model(dataclasses.replace(ROBOT, camera_time_offset_s=-0.01)).camera_time_offset_s == -0.01
