# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import OutputConfig, WheelConfig
from ceiling_dso_ros.fusion.graph import GraphEstimate
from ceiling_dso_ros.fusion.output import BlendedPose, Estimate, LiveOutput
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep

NOISE = WheelNoise(WheelConfig(radius_sigma=0.01), 0.5, 1e-4)
CONFIG = OutputConfig()


def wheel_steps(count, rate=(0.8, 0.0, 0.3)):
    return [WheelStep(k * 20_000_000, (k + 1) * 20_000_000, np.array(rate) / 50) for k in range(count)]


def estimate(stamp_ns, pose, sigma=0.01):
    constants = np.diag([1e-4, 1e-4])
    return GraphEstimate(stamp_ns, np.array(pose), np.eye(3) * sigma**2, 1.4, 0.002, np.zeros(2), constants)


def test_without_correction_the_blended_pose_follows_the_motion_exactly():
    blended, target = BlendedPose(CONFIG, np.zeros(3)), np.zeros(3)
    for _ in range(100):
        motion = planar.expmap([0.02, 0.0, 0.01])
        target = planar.compose(target, motion)
        result = blended.follow(motion, 0.02, Estimate(target, np.zeros((3, 3))))
    np.testing.assert_allclose(result.pose, target, atol=1e-9)
    np.testing.assert_allclose(result.covariance, 0.0, atol=1e-12)


def test_a_correction_is_worked_in_by_bounded_steps_and_the_covariance_knows_what_is_missing():
    blended = BlendedPose(CONFIG, np.zeros(3))
    target = Estimate(np.array([0.4, -0.3, 0.5]), np.zeros((3, 3)))
    before, missing = np.zeros(3), []
    for _ in range(300):
        result = blended.follow(np.zeros(3), 0.02, target)
        moved = planar.between(before, result.pose)
        assert np.hypot(*moved[:2]) <= CONFIG.max_correction_m_s * 0.02 + 1e-12
        assert abs(moved[2]) <= CONFIG.max_correction_rad_s * 0.02 + 1e-12
        before = result.pose
        missing.append(np.sqrt(result.covariance[2, 2]))
    assert missing[0] == pytest.approx(0.49, abs=0.01)
    assert missing[-1] < 1e-6
    np.testing.assert_allclose(before, target.pose, atol=1e-6)


def test_until_a_keyframe_comes_the_output_is_dead_reckoning():
    live = LiveOutput(CONFIG, NOISE, 0)
    for step in wheel_steps(50):
        live.predict(step, slipping=False, seen=False)
        pose, _, _ = live.publish(step)
    np.testing.assert_allclose(pose.pose, planar.expmap([0.8, 0.0, 0.3]), atol=1e-9)


def test_covariance_grows_while_blind_and_holds_the_radius_of_the_wheels():
    live, sigmas = LiveOutput(CONFIG, NOISE, 0), []
    for step in wheel_steps(500, rate=(0.8, 0.0, 0.0)):
        live.predict(step, slipping=False, seen=False)
        sigmas.append(np.sqrt(np.diag(live.publish(step)[0].covariance)))
    assert (np.diff(np.array(sigmas)[:, :2], axis=0) > 0).all()
    assert sigmas[-1][0] > 0.01 * 8.0


def test_after_a_keyframe_the_output_comes_to_the_graphs_estimate():
    live, steps = LiveOutput(CONFIG, NOISE, 0), wheel_steps(150)
    for step in steps[:50]:
        live.predict(step, slipping=False, seen=False)
        live.publish(step)
    correction = np.array([0.05, 0.02, 0.03])
    at_keyframe = planar.compose(planar.expmap(np.array([0.8, 0.0, 0.3]) * 0.9), correction)
    live.restart(estimate(900_000_000, at_keyframe), steps[45:50])
    for step in steps[50:]:
        live.predict(step, slipping=False, seen=False)
        pose, _, _ = live.publish(step)
    expected = planar.compose(at_keyframe, planar.expmap(np.array([0.8, 0.0, 0.3]) * 2.1))
    np.testing.assert_allclose(pose.pose, expected, atol=1e-3)


def test_slipping_wheels_are_replaced_by_going_on_as_before():
    live = LiveOutput(CONFIG, NOISE, 0)
    for step in wheel_steps(50, rate=(0.8, 0.0, 0.0)):
        live.predict(step, slipping=False, seen=False)
    believed = live.predict(WheelStep(1_000_000_000, 1_020_000_000, np.array([0.05, 0.0, 0.1])), True, seen=True)
    np.testing.assert_allclose(believed.twist, [0.016, 0.0, 0.0], atol=1e-3)
    assert not believed.known


def test_a_change_of_speed_that_no_robot_is_capable_of_waits_for_the_camera():
    """One encoder is stuck: within 20 ms the wheels show a turn with 2 rad/s."""
    steps = wheel_steps(80, rate=(0.8, 0.0, 0.0))
    stuck = [WheelStep(step.start_ns, step.end_ns, np.array([0.008, 0.0, 0.04])) for step in steps[50:]]
    for seen, expected in ((True, [0.016, 0.0, 0.0]), (False, [0.008, 0.0, 0.04])):
        live = LiveOutput(CONFIG, NOISE, 0)
        for step in steps[:50]:
            live.predict(step, slipping=False, seen=seen)
        believed = live.predict(stuck[0], slipping=False, seen=seen)
        np.testing.assert_allclose(believed.twist, expected, atol=1e-3)
        assert believed.known is not seen
        for step in stuck[1:]:  # in 0.6 s a robot may turn like that
            believed = live.predict(step, slipping=False, seen=seen)
        np.testing.assert_allclose(believed.twist, step.twist, atol=1e-12)
