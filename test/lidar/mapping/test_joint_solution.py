# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.lidar import uncertainty
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.elimination_kernels import eliminate_landmarks
from ceiling_dso_ros.lidar.mapping.graph import Relation
from ceiling_dso_ros.lidar.mapping.joint_solution import _relation_blocks, gauge_motions, solve_jointly
from ceiling_dso_ros.lidar.mapping.landmarks import KeyframePoints, find_landmarks
from ceiling_dso_ros.lidar.mapping.pose_kernels import SUMS
from ceiling_dso_ros.lidar.scans.poses import between, compose, inverse, transformed, wrap

pytestmark = pytest.mark.long

NOISE_M = 0.02


def scan_of_a_room(pose, rng, rays=720):
    """Points on the walls of 8 x 6 m, as a scanner at a pose sees them."""
    angles = np.linspace(-np.pi, np.pi, rays, endpoint=False) + pose[2] + 1e-4
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        reach = np.minimum(
            np.where(c > 0, (4.0 - pose[0]) / c, (-4.0 - pose[0]) / c),
            np.where(s > 0, (3.0 - pose[1]) / s, (-3.0 - pose[1]) / s),
        )
    reach = reach + NOISE_M * rng.standard_normal(rays)
    return np.column_stack([reach * np.cos(angles - pose[2]), reach * np.sin(angles - pose[2])])


def chain(poses, sigma):
    moved = between(poses[:-1], poses[1:])
    return [Relation(k, k + 1, step, np.eye(3) * sigma**2) for k, step in enumerate(moved)]


def solved(rng, count=12, start_error=0.03):
    truth = np.column_stack(
        [rng.uniform(-2.0, 2.0, count), rng.uniform(-1.5, 1.5, count), rng.uniform(-3.0, 3.0, count)]
    )
    parts = KeyframePoints.of([scan_of_a_room(pose, rng) for pose in truth], np.zeros(2))
    start = compose(truth, start_error * rng.standard_normal((count, 3)) * (1.0, 1.0, 0.3))
    return truth, solve_jointly(parts, start, chain(truth, 1.0), LidarConfig())


def test_poses_are_found_and_their_covariance_is_that_of_their_errors():
    rng = np.random.default_rng(0)
    errors, nees = [], []
    for _ in range(15):
        truth, joint = solved(rng)
        error = uncertainty.aligned_errors(joint.poses, truth)
        errors.append(error)
        nees.append(
            uncertainty.normalised_errors(error, uncertainty.keyframe_covariances(joint.information, joint.poses))
        )
    assert np.abs(errors).max() < 0.008
    # 15 x 12 x 3 numbers: the mean of chi squared over its degrees of freedom is within 0.2 of 1 in 99 of 100 cases
    assert np.mean(nees) == pytest.approx(1.0, abs=0.2)


def test_walls_on_the_border_of_two_cells_are_one_line():
    """The walls of the room lie on multiples of the cells, and its noise on both sides."""
    rng = np.random.default_rng(1)
    scans = KeyframePoints.of([scan_of_a_room(np.zeros(3), rng) for _ in range(10)], np.zeros(2))
    found = find_landmarks(scans, np.zeros((10, 3)), 0.15, 0.002)
    lines = found.lines[found.variances > 0]
    on_x, on_y = np.abs(np.abs(lines[:, 0]) - 4.0), np.abs(np.abs(lines[:, 1]) - 3.0)
    assert np.percentile(np.minimum(on_x, on_y), 95.0) < 0.01, "all but those in the corners"
    assert found.sigma_m == pytest.approx(NOISE_M, rel=0.3), "less at grazing incidence"
    assert found.count > 100


def test_eliminating_the_lines_is_the_schur_complement():
    rng = np.random.default_rng(2)
    keyframes, cells = 3, 4
    members = np.array([(k, c) for c in range(cells) for k in range(keyframes)], np.int32)
    lines = np.zeros((cells, 6))
    angles = rng.uniform(0, np.pi, cells)
    lines[:, 2], lines[:, 3] = np.cos(angles), np.sin(angles)
    sums, full, right = np.zeros((len(members), SUMS)), np.zeros((17, 17)), np.zeros(17)
    for row, (k, c) in enumerate(members):
        for e, s, g, w in rng.normal(size=(5, 4)):
            w = w**2 + 0.1
            sums[row] += w * np.array([1, g, g * g, s, s * s, g * s, e, e * g, e * s])
            J = np.zeros(17)
            J[3 * k : 3 * k + 3] = lines[c, 2], lines[c, 3], g
            J[9 + 2 * c : 11 + 2 * c] = -1.0, -s
            full += w * np.outer(J, J)
            right += w * J * e
    information, gradient = np.zeros((9, 9)), np.zeros(9)
    eliminate_landmarks(members, sums, lines, information, gradient)
    inner = np.linalg.inv(full[9:, 9:])
    np.testing.assert_allclose(information, full[:9, :9] - full[:9, 9:] @ inner @ full[9:, :9], atol=1e-6)
    np.testing.assert_allclose(gradient, right[:9] - full[:9, 9:] @ inner @ right[9:], atol=1e-6)


def test_relations_have_the_derivatives_of_their_error():
    rng = np.random.default_rng(3)
    poses = rng.normal(size=(2, 3))
    relation = Relation(0, 1, between(poses[:1], poses[1:])[0] + (0.001, -0.002, 0.001), np.diag([0.1, 0.2, 0.3]) ** 2)
    ((_, _, information, gradient),) = _relation_blocks(poses, [relation])

    def cost(delta):
        a, b = poses + delta.reshape(2, 3)
        seen = between(relation.moved[None], between(a[None], b[None]))[0]
        return 0.5 * np.sum((seen / (0.1, 0.2, 0.3)) ** 2)

    step = 1e-5
    numeric = [(cost(d) - cost(-d)) / (2 * step) for d in step * np.eye(6)]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-3, atol=1e-6)
    motion = gauge_motions(poses)
    np.testing.assert_allclose(information @ motion, 0.0, atol=1e-6)


def test_no_motion_of_the_whole_is_determined_and_none_is_in_the_covariance():
    _, joint = solved(np.random.default_rng(4), count=5)
    motions = gauge_motions(joint.poses)
    np.testing.assert_allclose(joint.information @ motions / np.abs(joint.information).max(), 0.0, atol=1e-4)
    assert np.isfinite(uncertainty.keyframe_covariances(joint.information, joint.poses)).all()


def test_a_scan_is_localised_between_the_lines():
    rng = np.random.default_rng(5)
    truth, joint = solved(rng, count=20)
    pose = np.array([0.4, -0.3, 0.5])
    # in the frame of the solution, which is a little away from that of the truth
    own = compose(joint.poses, inverse(truth)).mean(axis=0)
    start = compose(own[None], pose[None])[0] + (0.05, -0.04, 0.01)
    found = joint.landmark_map.localise(scan_of_a_room(pose, rng), start, np.eye(3) * 1e-3)
    expected = compose(own[None], pose[None])[0]
    assert np.abs(found.pose - expected)[:2].max() < 0.006
    assert abs(wrap(found.pose[2] - expected[2])) < 0.002
    assert found.fitting > 500


def test_points_are_placed():
    rng = np.random.default_rng(6)
    parts, poses = [rng.normal(size=(n, 2)) for n in (3, 0, 5)], rng.normal(size=(3, 3))
    keyframes = KeyframePoints.of(parts, np.array([0.3, 0.1]))
    expected = np.concatenate([transformed(p, T) for p, T in zip(parts, poses)])
    np.testing.assert_allclose(keyframes.placed(poses), expected)
    np.testing.assert_allclose(
        keyframes.eyes(poses), [transformed(np.array([[0.3, 0.1]]), T)[0] for T in poses], atol=1e-12
    )


def test_what_moves_and_what_is_looked_through_is_no_landmark():
    """A plate of 1 m that is somewhere else in each scan, in front of the wall."""
    rng = np.random.default_rng(7)
    parts = []
    for number in range(8):
        scan = scan_of_a_room(np.zeros(3), rng)
        plate = np.abs(scan[:, 1] - (-1.5 + 0.4 * number)) < 0.5 * np.abs(scan[:, 0]) / 2.0
        plate &= scan[:, 0] > 2.0
        scan[plate] *= (2.0 / scan[plate, 0])[:, None]
        parts.append(scan)
    found = find_landmarks(KeyframePoints.of(parts, np.zeros(2)), np.zeros((8, 3)), 0.15, 0.002)
    lines = found.lines[found.variances > 0]
    inside = (np.abs(lines[:, 0]) < 3.7) & (np.abs(lines[:, 1]) < 2.7)
    assert not inside.any()
    assert found.count > 80
