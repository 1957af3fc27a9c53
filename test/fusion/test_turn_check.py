# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from simulated_drive import mount, rotation_vector

from ceiling_dso_ros.dso import OdometryStatus, TrackingState
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.turn_check import TurnCheck
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

STEP_NS, IMAGE_NS, BEGIN_NS = 20_000_000, 66_000_000, 10**18
OFFSET_NS = 4_000_000
T_base_camera = mount()


def turning(t_s):
    """Yaw of a robot that turns now and then."""
    return 0.6 * np.interp(t_s % 8.0, [0.0, 2.0, 4.0, 6.0, 8.0], [0.0, 0.0, 2.0, 2.0, 0.0])


def driven(yaw, seconds, seed=0):
    """The wheels of a robot, one of them 1 % larger than believed."""
    rng, track = np.random.default_rng(seed), WheelTrack(WheelNoise(WheelConfig(), 0.5, 1e-4))
    for k in range(round(seconds * 1e9 / STEP_NS)):
        start_s, end_s = 1e-9 * k * STEP_NS, 1e-9 * (k + 1) * STEP_NS
        turn = yaw(end_s) - yaw(start_s) + 0.02 * 0.01 + 1e-4 * rng.normal()
        track.add(WheelStep(BEGIN_NS + k * STEP_NS, BEGIN_NS + (k + 1) * STEP_NS, np.array([0.02, 0.0, turn])))
    return track


def agrees(yaw, ahead_ns, seems_ns, seconds=9.0, seed=0):
    """Whether the stamps of images seem right that are `ahead_ns` after their times, and are held for `seems_ns`."""
    track, check, rng = driven(yaw, seconds, seed), TurnCheck(), np.random.default_rng(seed)
    R = T_base_camera[:3, :3]
    for k in range(round((seconds - 1.0) * 1e9 / IMAGE_NS)):
        T = np.eye(4)
        T[:3, :3] = R.T @ rotation_vector([0.0, 0.0, yaw(1e-9 * k * IMAGE_NS) + 2e-4 * rng.normal()]) @ R
        stamp_ns = BEGIN_NS + k * IMAGE_NS + ahead_ns - OFFSET_NS
        state = TrackingState.RETRYING if k % 20 == 7 else TrackingState.TRACKING
        status = OdometryStatus(stamp_ns, state, 0, keyframe_id=k // 6, T_keyframe_camera=T)
        check.add(status, T_base_camera, OFFSET_NS)
    return check.agrees(track, seems_ns)


SEEMS = pytest.mark.parametrize("seems_ns", [-900_000_000, -410_000_000, -100_000_000, 150_000_000, 700_000_000])


@SEEMS
@pytest.mark.parametrize("seed", range(3))
def test_stamps_at_which_camera_and_wheels_turn_alike_are_right(seems_ns, seed):
    assert agrees(turning, 0, seems_ns, seed=seed)


@SEEMS
@pytest.mark.parametrize("seed", range(3))
def test_stamps_of_a_clock_that_was_set_are_not(seems_ns, seed):
    """Also where it is not known exactly by how much."""
    assert not agrees(turning, seems_ns, seems_ns, seed=seed)
    assert not agrees(turning, seems_ns, round(0.8 * seems_ns), seed=seed)


@SEEMS
@pytest.mark.parametrize("yaw", [lambda t_s: 0.0 * t_s, lambda t_s: 0.5 * t_s], ids=["straight on", "in a circle"])
def test_without_a_change_of_the_rate_nothing_is_known(seems_ns, yaw):
    assert not agrees(yaw, 0, seems_ns)


@SEEMS
def test_a_camera_that_shows_another_motion_tells_nothing(seems_ns):
    track, check = driven(turning, 9.0), TurnCheck()
    for k in range(100):
        stamp_ns = BEGIN_NS + k * IMAGE_NS
        status = OdometryStatus(stamp_ns, TrackingState.TRACKING, 0, keyframe_id=0, T_keyframe_camera=np.eye(4))
        check.add(status, T_base_camera, 0)
    assert not check.agrees(track, seems_ns)


def test_before_the_wheels_nothing_is_known():
    assert not TurnCheck().agrees(WheelTrack(WheelNoise(WheelConfig(), 0.5, 1e-4)), 300_000_000)
