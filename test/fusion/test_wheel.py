# SPDX-License-Identifier: BSD-3-Clause
import lecture_hall
import numpy as np
import pytest

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.resolution import Resolution
from ceiling_dso_ros.fusion.wheel import FINEST_RAD, WheelOdometry
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

TICKS, RADIUS, BASE = 4000.0, 0.1, 0.5
TICK_M = 2 * np.pi * RADIUS / TICKS


def robot(**changes):
    return RobotModel(
        **{
            "T_base_camera": np.eye(4),
            "wheel_base_m": BASE,
            "wheel_radius_m": (RADIUS, RADIUS),
            "ticks_per_turn": TICKS,
            **changes,
        }
    )


def odometry(**changes):
    return WheelOdometry(robot(**changes), WheelConfig())


def drive(wheels, counts, dt=0.1):
    """Feed (left, right) counters; returns the steps."""
    return [wheels.add_ticks(nanoseconds(index * dt), *count) for index, count in enumerate(counts)]


def test_a_quarter_circle_is_integrated_exactly_in_one_step():
    wheels = WheelOdometry(robot(), WheelConfig(max_speed_m_s=20.0))
    arc = np.pi / 2 * np.array([1.0 - BASE / 2, 1.0 + BASE / 2])  # radius 1 m to the left
    drive(wheels, [(0, 0), np.round(arc / TICK_M)], dt=1.0)
    np.testing.assert_allclose(wheels.total.pose, [1.0, 1.0, np.pi / 2], atol=3e-4)


def test_there_is_no_total_before_the_first_sample():
    with pytest.raises(RuntimeError, match="not been heard"):
        _ = odometry().total


def test_the_first_sample_is_the_origin_whatever_the_counters_show():
    wheels = odometry()
    assert wheels.add_ticks(5_000_000_000, 123456, -98765) is None
    np.testing.assert_array_equal(wheels.total.pose, 0.0)


def test_counters_wrap_around_at_32_bit():
    top = 2**31 - 1
    wheels, plain = odometry(), odometry()
    drive(wheels, [(top - 10, top - 10), (-(2**31) + 89, -(2**31) + 189)])
    drive(plain, [(0, 0), (100, 200)])
    np.testing.assert_allclose(wheels.total.pose, plain.total.pose, atol=1e-12)
    assert plain.total.pose[0] > 0


def test_wheels_wrap_around_also_backwards():
    wheels = odometry()
    drive(wheels, [(-(2**31) + 10, -(2**31) + 10), (2**31 - 90, 2**31 - 90)])
    assert wheels.total.pose[0] == pytest.approx(-100 * TICK_M)


def test_a_restarted_counter_is_no_motion_of_kilometres():
    wheels = odometry()
    steps = drive(wheels, [(500000, 500000), (500100, 500100), (0, 0), (100, 100)])
    assert [step.known for step in steps[1:]] == [True, False, True]
    assert "restarted" in wheels.message or steps[2].twist[0] == pytest.approx(100 * TICK_M)
    assert wheels.total.pose[0] == pytest.approx(300 * TICK_M)  # it goes on as before, and says how unsure that is
    sigma_m = np.sqrt(wheels.covariance_odom[0, 0])
    assert 0.1 < sigma_m < 1.0


def test_reversed_wheels_count_the_other_way():
    plain, reversed_right = odometry(), odometry(reversed_wheels=(False, True))
    drive(plain, [(0, 0), (100, 150)])
    drive(reversed_right, [(0, 0), (100, -150)])
    np.testing.assert_allclose(reversed_right.total.pose, plain.total.pose, atol=1e-12)


def test_repeated_older_and_broken_samples_are_dropped_and_lose_no_motion():
    wheels = odometry()
    wheels.add_ticks(0, 0, 0)
    wheels.add_ticks(100_000_000, 100, 100)
    for stamp, left in ((100_000_000, 100), (50_000_000, 50), (150_000_000, float("nan"))):
        assert wheels.add_ticks(stamp, left, 100) is None
        assert wheels.message
    assert wheels.dropped == 3
    step = wheels.add_ticks(200_000_000, 200, 200)
    assert (step.start_ns, step.end_ns, wheels.message) == (100_000_000, 200_000_000, "")
    assert wheels.total.pose[0] == pytest.approx(200 * TICK_M)


def test_a_gap_is_one_long_step():
    wheels = odometry()
    wheels.add_ticks(0, 0, 0)
    step = wheels.add_ticks(2_000_000_000, 4000, 4000)
    assert step.known
    assert step.twist[0] == pytest.approx(4000 * TICK_M)


def test_angles_give_what_ticks_give_endless_or_wrapped():
    ticks, endless, wrapped = odometry(), odometry(), odometry()
    for index in range(40):
        left, right = 90 * index, 110 * index
        angles = 2 * np.pi * np.array([left, right]) / TICKS
        ticks.add_ticks(20_000_000 * index, left, right)
        endless.add_angles(20_000_000 * index, *angles)
        wrapped.add_angles(20_000_000 * index, *np.angle(np.exp(1j * angles)))
    np.testing.assert_allclose(endless.total.pose, ticks.total.pose, atol=1e-9)
    np.testing.assert_allclose(wrapped.total.pose, ticks.total.pose, atol=1e-9)


def accelerating(step_rad=0.0, wrapped=False, samples=100, hz=50.0):
    """Feeds angles of a start from rest in a curve, in steps of so much; returns the odometry."""
    wheels = odometry(ticks_per_turn=20.0)
    time_s = np.arange(samples) / hz
    left, right = 4.0 * time_s**2, 5.0 * time_s**2
    for index in range(samples):
        angles = np.array([left[index], right[index]])
        if step_rad:
            angles = np.round(angles / step_rad) * step_rad
        if wrapped:
            angles = np.angle(np.exp(1j * angles))
        wheels.add_angles(nanoseconds(index / hz), *angles)
    return wheels


def test_the_resolution_of_angles_is_theirs_and_not_that_of_the_ticks():
    fine, coarse = accelerating(), accelerating(step_rad=2 * np.pi / 90, wrapped=True)
    assert fine.noise.resolution_m == pytest.approx(FINEST_RAD * RADIUS)
    assert coarse.noise.resolution_m == pytest.approx(2 * np.pi / 90 * RADIUS)
    np.testing.assert_allclose(coarse.total.pose, fine.total.pose, atol=0.02)


def test_ticks_keep_the_resolution_of_the_robot():
    wheels = odometry()
    drive(wheels, [(0, 0), (7, 7), (16, 17)])
    assert wheels.noise.resolution_m == pytest.approx(TICK_M)


def test_the_resolution_of_an_odometry_is_that_of_its_way():
    wheels = odometry(ticks_per_turn=20.0)
    turn_m = 2 * np.pi / 90 * RADIUS
    for index in range(60):
        wheels.add_pose(100_000_000 * index, np.array([np.round(1.7 * index) * turn_m, 0.0, 0.0]))
    assert wheels.noise.resolution_m == pytest.approx(2.0 * turn_m)  # one wheel's, if the other one stood


FINEST, STEP = 1e-3, 0.07


def resolution(readings, times_s=None):
    found = Resolution(FINEST)
    times_s = 0.02 * np.arange(len(readings)) if times_s is None else times_s
    for change, duration_s in zip(np.diff(readings), np.diff(times_s)):
        found.add(np.array([change]), duration_s)
    return found.step


def test_readings_that_go_to_and_fro_by_a_step_have_its_resolution():
    for speed in (0.2, 0.5, 3.3, 20.0):
        assert resolution(np.round(speed * 0.02 * np.arange(200) / STEP) * STEP) == pytest.approx(STEP)


def test_a_constant_speed_tells_nothing():
    """Nor does one that changes evenly, as in a simulation, also where samples are missing or the robot stops."""
    steady = 0.1 * np.arange(300.0)
    kept = np.random.default_rng(0).random(300) > 0.2
    stop_and_go = np.cumsum(0.1 * ((np.arange(2000) // 100) % 2))
    assert resolution(steady) == resolution(steady[kept], 0.02 * np.flatnonzero(kept)) == FINEST
    assert resolution(stop_and_go) == resolution(0.01 * np.arange(100.0) ** 2) == FINEST


def test_readings_of_a_real_robot_are_as_fine_as_they_are():
    rng = np.random.default_rng(0)
    times_s = 0.02 * np.arange(300) + 0.001 * rng.normal(size=300)
    assert resolution(5.0 * times_s, times_s) == FINEST
    assert resolution(np.round(5.0 * times_s / STEP) * STEP, times_s) == pytest.approx(STEP)


def test_wrapped_angles_with_some_samples_missing_are_the_turn_that_was_driven():
    """In 0.3 s a wheel could have turned back by nearly a turn; but it was turning ahead."""
    for wrapped in (False, True):
        wheels = odometry()
        ages_s = [*np.arange(0.0, 1.4, 0.02), *np.arange(1.7, 2.4, 0.02)]  # it wraps meanwhile
        for age_s in ages_s:
            angle = 6.0 * age_s
            wheels.add_angles(nanoseconds(age_s), *[np.angle(np.exp(1j * angle)) if wrapped else angle] * 2)
        assert wheels.total.pose[0] == pytest.approx(6.0 * ages_s[-1] * RADIUS)


def test_endless_angles_are_right_after_any_silence():
    wheels = odometry()
    for age_s, angle in ((0.0, 0.0), (0.02, 0.1), (0.04, 0.2), (10.0, 30.0), (20.0, 5.0)):
        wheels.add_angles(nanoseconds(age_s), angle, angle)
    assert wheels.total.pose[0] == pytest.approx(0.5)


@pytest.mark.parametrize("gap_s", [0.02, 0.1, 0.15, 0.5, 5.0, 20.0])
@pytest.mark.parametrize("unit", ["angles", "ticks", "poses"])
def test_readings_that_begin_again_are_no_motion_whatever_the_silence(unit, gap_s):
    """As after a restart of the driver; the robot stands before and after."""
    for far in np.random.default_rng(0).uniform(20.0, 900.0, (10, 2)):
        wheels = odometry()
        samples = [(0.02 * k, far) for k in range(10)] + [(0.18 + gap_s, np.zeros(2))]
        for time_s, value in samples:
            stamp_ns = nanoseconds(time_s)
            if unit == "angles":
                step = wheels.add_angles(stamp_ns, *value)
            elif unit == "ticks":
                step = wheels.add_ticks(stamp_ns, *np.round(value / (2 * np.pi) * TICKS).astype(int))
            else:
                step = wheels.add_pose(stamp_ns, np.array([*value, 1.0 if value.any() else 0.0]))
        assert not step.known
        assert "restarted" in wheels.message
        np.testing.assert_allclose(wheels.total.pose, 0.0, atol=1e-9)


def test_wrapped_angles_tell_nothing_after_a_silence_in_which_the_wheel_turned():
    """Nobody knows how many turns they are; a wheel that has not moved has stood."""
    wheels = odometry()
    for k in range(10):
        wheels.add_angles(nanoseconds(0.02 * k), 1.0, 1.0)
    assert wheels.add_angles(nanoseconds(3.0), 1.05, 1.05).known
    assert not wheels.add_angles(nanoseconds(6.0), 2.0, 2.0).known


def test_an_odometry_is_taken_as_it_is():
    wheels = odometry()
    poses = [np.array([3.0 + 0.1 * k, 4.0 + 0.02 * k * k, 0.05 * k]) for k in range(6)]
    for index, pose in enumerate(poses):
        wheels.add_pose(100_000_000 * index, pose)
    np.testing.assert_allclose(wheels.total.pose, planar.between(poses[0], poses[-1]), atol=1e-12)


def test_parts_of_a_step_make_the_step():
    noise = WheelNoise(WheelConfig(), BASE, TICK_M)
    step = WheelStep(1_000_000_000, 2_000_000_000, np.array([0.5, 0.0, 0.4]))
    whole = noise.extend(WheelMotion.nothing(1_000_000_000), step)
    parts = noise.extend(
        noise.extend(WheelMotion.nothing(1_000_000_000), step.clip(0, 1_300_000_000)),
        step.clip(1_300_000_000, 9_000_000_000),
    )
    np.testing.assert_allclose(parts.pose, whole.pose, atol=1e-12)
    np.testing.assert_allclose(parts.jacobian, whole.jacobian, atol=1e-12)
    np.testing.assert_allclose(parts.noise, whole.noise, atol=0.02 * np.abs(whole.noise).max())
    assert step.clip(2.0, 3.0) is None


def test_jacobian_is_the_derivative_by_the_constants():
    def pose(radius, ratio, base):
        model = robot(
            wheel_base_m=BASE * np.exp(base),
            wheel_radius_m=(RADIUS * np.exp(radius - ratio / 2), RADIUS * np.exp(radius + ratio / 2)),
        )
        wheels = WheelOdometry(model, WheelConfig())
        drive(wheels, [(150 * k, 230 * k + 3 * k * k) for k in range(20)])
        return wheels.total

    nominal = pose(0.0, 0.0, 0.0)
    for column, step in enumerate(1e-6 * np.eye(3)):
        change = planar.between(pose(*-step).pose, pose(*step).pose) / 2e-6
        np.testing.assert_allclose(nominal.jacobian[:, column], change, atol=1e-5)


def test_covariance_is_that_of_simulated_wheels():
    config = WheelConfig(noise_m_per_sqrt_m=0.01)
    noise = WheelNoise(config, BASE, 1e-9)
    rng = np.random.default_rng(0)
    true = np.tile([0.02, 0.05], (60, 1))  # left and right wheel, metres a step
    ends, motion = [], WheelMotion.nothing(0)
    for _ in range(4000):
        wheels = true + config.noise_m_per_sqrt_m * np.sqrt(true) * rng.normal(size=true.shape)
        twists = np.column_stack([wheels.mean(axis=1), np.zeros(60), (wheels[:, 1] - wheels[:, 0]) / BASE])
        pose = np.zeros(3)
        for twist in twists:
            pose = planar.compose(pose, planar.expmap(twist))
        ends.append(pose)
    for index, (left, right) in enumerate(true):
        step = WheelStep(index * 10**9, (index + 1) * 10**9, np.array([(left + right) / 2, 0.0, (right - left) / BASE]))
        motion = noise.extend(motion, step)
    errors = np.array([planar.between(motion.pose, end) for end in ends])
    predicted = noise.covariance(motion, np.zeros((3, 3)))
    np.testing.assert_allclose(np.cov(errors.T), predicted, atol=0.08 * np.abs(predicted).max())
    assert np.mean(np.einsum("ni,ij,nj->n", errors, np.linalg.inv(predicted), errors)) == pytest.approx(3.0, abs=0.4)


@pytest.mark.long
def test_real_dead_reckoning_errs_as_its_covariance_says():
    if not lecture_hall.FOLDER.is_dir():
        pytest.skip(f"the recording is missing: {lecture_hall.FOLDER}")
    normalised = np.abs(lecture_hall.normalised_errors())
    assert np.mean((normalised < 3.0).all(axis=1)) >= 0.95
    assert np.median(normalised, axis=0).min() > 0.05  # nor is the covariance idle


def test_a_corrected_step_is_that_of_the_true_wheels():
    ratio, base = 0.01, -0.02
    nominal, true = (
        odometry(),
        odometry(
            wheel_radius_m=(RADIUS * np.exp(-ratio / 2), RADIUS * np.exp(ratio / 2)), wheel_base_m=BASE * np.exp(base)
        ),
    )
    (_, seen), (_, expected) = (drive(wheels, [(0, 0), (250, 400)]) for wheels in (nominal, true))
    corrected = nominal.noise.corrected(seen, np.array([ratio, base]))
    np.testing.assert_allclose(corrected.twist, expected.twist, rtol=2e-3)
    assert corrected.twist[2] > 1.03 * seen.twist[2]


def test_the_way_of_a_circle_is_not_its_chord():
    wheels, turn = odometry(), 4.0 * np.pi
    for k in range(401):
        wheels.add_ticks(
            100_000_000 * k, *np.round(np.array([1.0 - BASE / 2, 1.0 + BASE / 2]) * turn * k / 400 / TICK_M)
        )
    assert np.hypot(*wheels.total.pose[:2]) < 0.05
    assert wheels.noise.way_m(wheels.total) == pytest.approx(turn * (1.0 + BASE / 2), rel=0.01)


@pytest.mark.parametrize("latency_s", [0.003, 0.01, 0.03])
def test_stamps_of_a_busy_computer_cost_no_way(latency_s):
    """Ticks are stamped when they arrive: each some time late, the next one may follow at once."""
    wheels, random = odometry(), np.random.default_rng(0)
    dt, speed = 0.02, 1.4
    taken_s = dt * np.arange(2000)
    arrived_s = np.maximum.accumulate(taken_s + random.exponential(latency_s, len(taken_s))) + 1e-6 * np.arange(2000)
    for stamp_s, count in zip(arrived_s, np.round(speed * taken_s / TICK_M)):
        wheels.add_ticks(nanoseconds(stamp_s), count, count)
        assert wheels.message == ""
    assert wheels.total.pose[0] == pytest.approx(speed * taken_s[-1], abs=2 * TICK_M)


def test_ticks_of_a_while_that_arrive_at_once_cost_no_way():
    wheels, speed = odometry(), 1.0
    taken_s = 0.02 * np.arange(200)
    held = (taken_s > 2.0) & (taken_s < 2.4)
    arrived_s = np.where(held, 2.4 - 1e-4 * (2.4 - taken_s), taken_s)
    for stamp_s, count in zip(arrived_s, np.round(speed * taken_s / TICK_M)):
        wheels.add_ticks(nanoseconds(stamp_s), count, count)
        assert wheels.message == ""
    assert wheels.total.pose[0] == pytest.approx(speed * taken_s[-1], abs=2 * TICK_M)


def test_a_counter_that_leaps_is_no_motion_though_stamps_jitter():
    wheels = odometry()
    drive(wheels, [(0, 0), (400, 400), (400 + 12_000, 400)], dt=0.1)  # 3.8 m in 0.1 s
    assert "impossible motion" in wheels.message
