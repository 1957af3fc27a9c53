# SPDX-License-Identifier: BSD-3-Clause
import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion.calibration import CalibrationError, calibrate
from ceiling_dso_ros.fusion.calibration_data import CameraPose
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry

pytestmark = pytest.mark.long(minutes=2)

TRUE = {"camera roll": 1.5, "camera pitch": -1.0, "camera yaw": -88.0, "camera x": 0.18, "camera y": 0.04}
OFFSET_S, RATIO, BASE_M = -0.013, np.exp(0.01), 0.485 * np.exp(-0.01)
TRUE.update({"camera time offset": OFFSET_S, "wheel ratio right/left": RATIO, "wheel base": BASE_M})


def camera(yaw_deg, xyz):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    T[:3, 3] = xyz
    return T


@pytest.fixture(scope="module")
def result_of(simulate, truth):
    """Calibrates a simulated drive from a guess, by default one that is wrong in everything."""

    @functools.lru_cache(maxsize=None)
    def drive_of(sequence, seconds, seed, **changes):
        real = truth(ratio=0.01, base=-0.01, camera_delay_s=-OFFSET_S, wheel_noise=3e-4, **changes)
        return simulate(sequence, seconds, seed, real)

    def run(sequence, seconds=60.0, seed=0, guess_deg=40.0, **changes):
        drive = drive_of(sequence, seconds, seed, **changes)
        robot = RobotModel(camera(guess_deg, (0.1, 0.0, 0.62)), 0.485, (0.098, 0.098))
        wheels = WheelOdometry(robot, WheelConfig())
        steps = [step for step in (wheels.add_ticks(*sample) for sample in drive.ticks) if step is not None]
        poses = [CameraPose(s.stamp_ns, s.segment, s.T_world_camera) for s in drive.statuses if s.keyframe_id >= 0]
        return calibrate(steps, poses, robot)

    return run


def values(calibration):
    return {value.name: value for value in calibration.values}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("guess_deg", [-90.0, 40.0, 175.0])
def test_loops_give_everything_from_any_guess(result_of, seed, guess_deg):
    calibration = result_of("loops", seed=seed, guess_deg=guess_deg)
    assert (calibration.left_out, calibration.slips) == (0, ())
    found = values(calibration)
    assert all(value.excited for value in found.values())
    assert found["camera yaw"].value == pytest.approx(TRUE["camera yaw"], abs=0.1)
    assert found["camera roll"].value == pytest.approx(TRUE["camera roll"], abs=0.2)
    assert found["camera pitch"].value == pytest.approx(TRUE["camera pitch"], abs=0.2)
    assert found["camera x"].value == pytest.approx(TRUE["camera x"], abs=0.01)
    assert found["camera y"].value == pytest.approx(TRUE["camera y"], abs=0.01)
    assert found["camera time offset"].value == pytest.approx(OFFSET_S, abs=0.002)
    assert found["wheel ratio right/left"].value == pytest.approx(RATIO, rel=0.002)
    assert found["wheel base"].value == pytest.approx(BASE_M, rel=0.002)


def test_standard_deviations_are_about_the_errors(result_of):
    errors = [
        (value.value - TRUE[value.name]) / value.sigma
        for seed in range(8)
        for value in result_of("loops", seconds=40.0, seed=seed).values
    ]
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 2.0


def test_the_robot_has_what_was_found(result_of):
    calibration = result_of("loops")
    robot, found = calibration.robot, values(calibration)
    assert robot.wheel_radius_m[1] / robot.wheel_radius_m[0] == pytest.approx(found["wheel ratio right/left"].value)
    assert np.mean(np.log(robot.wheel_radius_m)) == pytest.approx(np.log(0.098))
    assert robot.wheel_base_m == found["wheel base"].value
    assert robot.camera_time_offset_s == found["camera time offset"].value
    assert robot.T_base_camera[2, 3] == 0.62
    yaw, pitch, roll = Rotation.from_matrix(robot.T_base_camera[:3, :3]).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose([roll, pitch, yaw], [found[f"camera {n}"].value for n in ("roll", "pitch", "yaw")])


def test_a_straight_drive_cannot_tell_lever_and_wheel_base(result_of):
    calibration = result_of("straight", seconds=20.0, guess_deg=-90.0)
    assert calibration.slips == ()
    found = values(calibration)
    for name in ("camera x", "camera y", "wheel base"):
        assert not found[name].excited, name
    assert sum(not found[name].excited for name in ("camera roll", "camera pitch")) == 1
    assert found["camera yaw"].excited
    assert found["wheel ratio right/left"].excited
    assert calibration.robot.wheel_base_m == 0.485
    np.testing.assert_array_equal(calibration.robot.T_base_camera[:3, 3], [0.1, 0.0, 0.62])


def test_turns_on_the_spot_cannot_tell_where_ahead_is(result_of):
    calibration = result_of("spin")
    assert calibration.slips == ()
    found = values(calibration)
    for name in ("camera yaw", "camera x", "camera y", "wheel ratio right/left"):
        assert not found[name].excited, name
    assert found["wheel base"].value == pytest.approx(BASE_M, rel=0.002)
    assert found["camera roll"].value == pytest.approx(TRUE["camera roll"], abs=0.2)


def deviations(calibration):
    return [(value.value - TRUE[value.name]) / value.sigma for value in calibration.values]


SLIPS = ((7.2, 7.7), (20.0, 20.5), (31.1, 32.3), (40.0, 40.5), (52.9, 53.0))


@pytest.mark.parametrize("factor", [2.0, 0.3, 1.1])
def test_slips_are_left_out_and_named(result_of, factor):
    """Also a wheel that is blocked, and one that slips by a tenth."""
    found = [result_of("loops", seed=seed, slips=SLIPS, slip_factor=factor) for seed in range(2)]
    for calibration in found:
        assert calibration.left_out < 50
        for slip in calibration.slips:
            start_s, end_s = (seconds(stamp_ns) - 1000.0 + OFFSET_S for stamp_ns in (slip.start_ns, slip.end_ns))
            assert any(start - 1.0 < start_s and end_s < end + 1.0 for start, end in SLIPS), (start_s, end_s)
            assert slip.what.startswith("the left wheel turned ")
            assert slip.what.endswith("too far" if factor > 1.0 else "too little")
        assert len(calibration.slips) >= (4 if factor != 1.1 else 2)
    assert np.sqrt(np.mean(np.square([deviations(calibration) for calibration in found]))) < 2.0


def test_a_wheel_that_slips_little_for_long_does_not_bias_the_result(result_of):
    found = [result_of("loops", seed=seed, slips=((10.0, 16.0), (30.0, 38.0)), slip_factor=1.02) for seed in range(2)]
    assert all(calibration.slips for calibration in found)
    ratios = [values(calibration)["wheel ratio right/left"] for calibration in found]
    assert np.mean([ratio.value for ratio in ratios]) == pytest.approx(RATIO, rel=0.0005)
    assert np.sqrt(np.mean(np.square([deviations(calibration) for calibration in found]))) < 2.0


def test_a_lost_camera_does_little_harm(result_of):
    found = values(result_of("loops", slips=((20.0, 20.5), (40.0, 40.5)), losses=((30.0, 32.0),)))
    assert found["camera yaw"].value == pytest.approx(TRUE["camera yaw"], abs=0.1)
    assert found["wheel base"].value == pytest.approx(BASE_M, rel=0.002)


def test_wheels_of_another_robot_are_refused(result_of):
    with pytest.raises(CalibrationError, match="wheels and camera disagree about"):
        result_of("loops", slips=tuple((start, start + 0.7) for start in np.arange(2.0, 60.0, 1.4)))


def test_too_little_motion_is_said(result_of):
    with pytest.raises(CalibrationError, match="drive for longer"):
        result_of("loops", seconds=4.0)


def test_stamps_of_this_century_are_fine(simulate, truth):
    """Seconds since 1970 leave no room for the steps of a numeric derivative."""
    drive = simulate("loops", 40.0, 0, truth(camera_delay_s=0.02, wheel_noise=3e-4), start_ns=1_700_000_000 * 10**9)
    wheels = WheelOdometry(drive.robot, WheelConfig())
    steps = [step for step in (wheels.add_ticks(*sample) for sample in drive.ticks) if step is not None]
    poses = [CameraPose(s.stamp_ns, s.segment, s.T_world_camera) for s in drive.statuses if s.keyframe_id >= 0]
    found = values(calibrate(steps, poses, drive.robot))
    assert found["camera time offset"].value == pytest.approx(-0.02, abs=0.002)
