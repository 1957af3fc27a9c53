# SPDX-License-Identifier: BSD-3-Clause
"""Whole drives in the simulator; all of them are long but for the first."""

from dataclasses import replace

import numpy as np
import pytest

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.reference_sigma import ReferenceSigma, reference_part
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.experiments.scanned_drive import ReferenceErrors, ScannedDrive, with_ranges
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.pose_covariances import PoseCovariances
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.lidar.reference import estimate_reference
from ceiling_dso_ros.lidar.scans.poses import matrices
from ceiling_dso_ros.lidar.uncertainty import aligned_errors
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

LASER = LaserModel(rays=1081, range_noise_m=0.02)
# What issue a user has with a reference: it must be good to a centimetre and a tenth of a degree.
GOOD_M, GOOD_DEG = 0.01, 0.1
CORRIDOR = Obstacles(np.array([[[-80.0, -0.4], [80.0, -0.4]], [[-80.0, 2.0], [80.0, 2.0]]]))  # its ends out of reach


@pytest.fixture(scope="module")
def drive():
    return ScannedDrive(SimulationConfig("loops", seed=1, duration_s=30.0, laser=LASER, traffic=10))


@pytest.fixture(scope="module")
def estimated(drive):
    said = []
    return estimate_reference(drive.scans, drive.wheels, warn=said.append), said


@pytest.mark.long
def test_it_is_right_and_knows_how_right(drive, estimated):
    reference, said = estimated
    errors = ReferenceErrors.of(reference, drive.truth)
    assert errors.position_m < GOOD_M
    assert errors.yaw_deg < GOOD_DEG
    assert 0.6 < errors.nees < 1.5, "300 poses, whose errors are not all independent"
    assert said == []
    assert reference.solution.track.is_matched.all()
    assert reference.odd_even.position_m < GOOD_M
    assert reference.backwards.position_m < GOOD_M


@pytest.mark.long
def test_it_is_right_without_wheels(drive):
    errors = ReferenceErrors.of(estimate_reference(drive.scans, None, check_itself=False), drive.truth)
    assert errors.position_m < 2 * GOOD_M
    assert errors.yaw_deg < GOOD_DEG


@pytest.mark.long
def test_the_same_scans_give_the_same_bytes(drive, estimated):
    again = estimate_reference(drive.scans, drive.wheels)
    assert again.path.poses.tobytes() == estimated[0].path.poses.tobytes()
    assert again.covariances.tobytes() == estimated[0].covariances.tobytes()


@pytest.mark.long
def test_odometry_is_judged_as_by_the_truth(drive, estimated):
    reference, _ = estimated
    stamps = reference.path.stamps_ns
    wheels = Trajectory.from_matrices(stamps, matrices(drive.wheels.path.at(stamps)))
    by_it, by_truth = (
        evaluate_trajectory("wheel", wheels, against, AlignmentKind.SE2, 0.001)
        for against in (reference.trajectory(), drive.true_trajectory)
    )
    part = reference_part(by_it, ReferenceSigma.of(PoseCovariances(stamps, reference.covariances)))
    assert by_truth.ate_m.rmse > 5 * part.position_m, "there is something to judge"
    assert abs(by_it.ate_m.rmse - by_truth.ate_m.rmse) < part.position_m


@pytest.mark.long
def test_between_scans_the_wheels_tell(drive, estimated):
    reference, _ = estimated
    between_ns = reference.path.stamps_ns[:-1] + 50_000_000
    truth = drive.recording.simulation.robot.motion.poses((between_ns - drive.scans.stamps_ns[0]) / 1e9 + 0.05)
    errors = aligned_errors(reference.at(between_ns), truth)
    assert np.sqrt(np.mean(errors[:, :2] ** 2)) < GOOD_M
    np.testing.assert_allclose(reference.at(reference.path.stamps_ns), reference.path.poses, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("with_wheels", [True, False])
def test_in_a_corridor_the_covariance_says_that_it_does_not_know(with_wheels):
    laser = replace(LASER, lost_share=0.6)  # glass
    drive = ScannedDrive(SimulationConfig("straight", seed=2, laser=laser), CORRIDOR)
    said = []
    reference = estimate_reference(
        drive.scans, drive.wheels if with_wheels else None, check_itself=False, warn=said.append
    )
    errors = aligned_errors(reference.path.poses, drive.truth)
    along, across = np.sqrt(reference.covariances[:, 0, 0]), np.sqrt(reference.covariances[:, 1, 1])
    assert np.median(along) > 5 * np.median(across)
    assert np.all(np.abs(errors[:, 0]) < 4 * along)
    assert reference.is_corridor.mean() > 0.9
    assert any("corridor" in line for line in said)
    assert any("valid range" in line for line in said)


@pytest.mark.long
@pytest.mark.parametrize("lost", [np.nan, 0.0, np.inf])
def test_a_dirty_scanner_is_said_and_does_little(drive, lost):
    dirty = np.random.default_rng(0).random(drive.scans.ranges_m.shape) < 0.5
    said = []
    ranges = np.where(dirty, lost, drive.scans.ranges_m)
    reference = estimate_reference(
        with_ranges(drive.scans, np.where(np.isfinite(ranges) & (ranges > 0), ranges, np.nan)),
        drive.wheels, check_itself=False, warn=said.append,
    )  # fmt: skip
    assert ReferenceErrors.of(reference, drive.truth).position_m < GOOD_M
    assert len(said) == 1 and "% of the rays have a valid range" in said[0]


@pytest.mark.long
def test_scans_that_turn_clockwise_or_hang_upside_down():
    drive = ScannedDrive(SimulationConfig("loops", seed=3, duration_s=20.0, laser=replace(LASER, clockwise=True)))
    assert drive.scans.geometry[0, 1] < 0.0
    found = estimate_reference(drive.scans, drive.wheels, check_itself=False)
    assert ReferenceErrors.of(found, drive.truth).position_m < GOOD_M
    geometry = drive.scans.geometry * (-1.0, -1.0, 1.0)
    turned = drive.scans.T_base_laser @ np.diag([1.0, -1.0, -1.0, 1.0])
    hanging = estimate_reference(
        replace(drive.scans, geometry=geometry, T_base_laser=turned), drive.wheels, check_itself=False
    )
    assert ReferenceErrors.of(hanging, drive.truth).position_m < GOOD_M
    said = []
    estimate_reference(replace(drive.scans, geometry=geometry), drive.wheels, check_itself=False, warn=said.append)
    assert any("upside down" in line for line in said)


@pytest.mark.long
@pytest.mark.parametrize(("error", "words"), [((0.0, 0.0, 0.09), "its yaw by -5"), ((0.1, 0.0, 0.0), "its x by -0.")])
def test_a_wrong_mount_is_told(drive, error, words):
    said = []
    wrong = planar.lift(np.array(error)) @ drive.scans.T_base_laser
    estimate_reference(replace(drive.scans, T_base_laser=wrong), drive.wheels, check_itself=False, warn=said.append)
    assert any("correct the mount of the laser" in line and words in line for line in said)


def test_a_robot_that_stands_and_a_single_scan():
    drive = ScannedDrive(SimulationConfig("square", seed=4, duration_s=2.0, laser=LaserModel(rays=541)))
    still = drive.scans.select(np.arange(9))
    reference = estimate_reference(still, drive.wheels)
    errors = ReferenceErrors.of(reference, drive.truth[:9])
    assert errors.position_m < GOOD_M
    assert np.isfinite(reference.covariances).all()
    assert reference.numbers()["path_m"] < 0.1
    one = estimate_reference(drive.scans.select(np.arange(1)), None)
    assert one.path.poses.shape == (1, 3)
    assert np.isfinite(one.covariances).all()


def test_a_plane_that_stands_upright_is_refused():
    drive = ScannedDrive(SimulationConfig("square", seed=4, duration_s=1.0, laser=LaserModel(rays=100)))
    upright = np.eye(4)
    upright[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    with pytest.raises(InputError, match="turns the plane of the scans by 90 degrees"):
        estimate_reference(replace(drive.scans, T_base_laser=upright), None)
