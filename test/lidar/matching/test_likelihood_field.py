# SPDX-License-Identifier: BSD-3-Clause
import itertools

import numpy as np
import pytest

from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.matching.likelihood_field import LikelihoodField
from ceiling_dso_ros.lidar.matching.matching_kernels import _linearize
from ceiling_dso_ros.lidar.matching.search_kernels import NO_PLACE, place_score, search_places
from ceiling_dso_ros.lidar.scans.poses import inverse, transformed

CONFIG = LidarConfig()
WEAK = np.eye(3) * 1e-6


def wall(start, end, count, rng, noise_m=0.01):
    share = np.sort(rng.random(count))[:, None]
    return np.array(start) + share * np.subtract(end, start) + noise_m * rng.standard_normal((count, 2))


def room(rng, noise_m=0.01):
    """6 x 4 m with a pillar, so that no two places look alike."""
    corners = [(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0)]
    parts = [wall(a, b, 300, rng, noise_m) for a, b in zip(corners, [*corners[1:], corners[0]])]
    return np.concatenate(
        [*parts, wall((1.0, 0.5), (1.0, 1.0), 50, rng, noise_m), wall((1.0, 1.0), (1.6, 1.0), 60, rng, noise_m)]
    )


def field_of(points, radius_m=6.0):
    field = LikelihoodField(radius_m, CONFIG)
    field.add(points)
    return field


@pytest.mark.long
def test_gauss_newton_finds_the_pose_and_its_information_tells_the_error():
    rng = np.random.default_rng(0)
    errors, sigmas = [], []
    for _ in range(40):
        field = field_of(np.concatenate([room(rng) for _ in range(8)]))
        pose = rng.uniform(-1.0, 1.0, 3) * (0.5, 0.5, 0.4)
        points = transformed(room(rng), inverse(pose))
        start = pose + rng.uniform(-1.0, 1.0, 3) * (0.06, 0.06, 0.02)
        match = field.align(points, start, start, WEAK)
        errors.append(match.pose - pose)
        sigmas.append(np.sqrt(np.diag(np.linalg.inv(match.information))))
        assert match.fit > 0.8
    errors, sigmas = np.array(errors), np.array(sigmas)
    assert np.abs(errors).max() < 0.005
    # the field is not exact either: its points make the error a little larger than the information says
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 2.5 * sigmas.mean(axis=0))


def test_along_a_corridor_only_the_prior_counts():
    rng = np.random.default_rng(1)
    walls = np.concatenate([wall((-5.0, y), (5.0, y), 800, rng) for y in (-1.0, 1.0)])
    match = field_of(walls, 8.0).align(
        wall((-2.0, 1.0), (2.0, 1.0), 300, rng), np.array([0.05, 0.03, 0.0]), np.array([0.05, 0.0, 0.0]),
        np.diag([1e4, 1e-6, 1e-6]),
    )  # fmt: skip
    assert match.pose[0] == pytest.approx(0.05, abs=0.01), "the directions of its lines have noise, too"
    assert match.pose[1] == pytest.approx(0.0, abs=3e-3)
    assert match.information[0, 0] < 1e-3 * match.information[1, 1]


def test_gradient_is_that_of_the_likelihood():
    rng = np.random.default_rng(2)
    field = field_of(room(rng))
    points = room(rng)[::7]
    pose = np.array([0.013, -0.02, 0.01])

    def sums(at):
        gradient, information, outer = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        _linearize(points, field._distributions, field._origin, CONFIG.cell_m, at, 1.0, gradient, information, outer)
        return gradient

    def cost(at):
        """Half of the sum of GATE m^2 / (GATE + m^2)."""
        moved = transformed(points, at)
        cells = np.floor((moved - field._origin) / CONFIG.cell_m).astype(int)
        d = field._distributions[cells[:, 1], cells[:, 0]].astype(float)
        e = moved - d[:, :2]
        m2 = d[:, 2] * e[:, 0] ** 2 + 2 * d[:, 3] * e[:, 0] * e[:, 1] + d[:, 4] * e[:, 1] ** 2
        return 0.5 * np.sum(np.where(d[:, 5] > 0, 9.0 * m2 / (9.0 + m2), 0.0))

    step = 1e-7  # so small that no point changes its cell
    numeric = [(cost(pose + d) - cost(pose - d)) / (2 * step) for d in step * np.eye(3)]
    np.testing.assert_allclose(sums(pose), numeric, rtol=1e-3, atol=1e-2)


@pytest.mark.long
def test_search_finds_a_pose_that_is_far_away():
    rng = np.random.default_rng(3)
    field = field_of(np.concatenate([room(rng) for _ in range(3)]))
    for _ in range(10):
        pose = rng.uniform(-1.0, 1.0, 3) * (0.7, 0.7, 0.6)
        place = field.search(transformed(room(rng), inverse(pose)), np.zeros(3), 0.8, 0.7, 0.3)
        assert place is not None
        assert np.abs(place.pose - pose)[:2].max() < 0.08
        assert abs(place.pose[2] - pose[2]) < 0.03
        assert (
            field.search(transformed(room(rng), inverse(pose)), np.zeros(3), 0.8, 0.7, 0.9 * place.score, place.pose)
            is None
        )


def test_a_corridor_has_other_places_that_are_as_good():
    rng = np.random.default_rng(4)
    walls = np.concatenate([wall((-8.0, y), (8.0, y), 1500, rng) for y in (-1.0, 1.0)])
    field = field_of(walls, 9.0)
    points = np.concatenate([wall((-3.0, y), (3.0, y), 300, rng) for y in (-1.0, 1.0)])
    place = field.search(points, np.zeros(3), 2.0, 0.1, 0.3)
    other = field.search(points, np.zeros(3), 2.0, 0.1, 0.93 * place.score, place.pose)
    assert np.abs(place.pose[:2]).max() < 0.16, "of equal places the nearest"
    assert other is not None
    assert abs(other.pose[0]) > 0.5


@pytest.mark.parametrize("seed", range(5))
def test_branch_and_bound_finds_what_looking_everywhere_finds(seed):
    rng = np.random.default_rng(seed)
    raster = np.zeros((90, 90), np.uint8)
    raster[tuple(rng.integers(30, 60, (2, 60)))] = rng.integers(50, 255, 60)
    levels = np.zeros((4, 90, 90), np.uint8)
    for level, row, column in itertools.product(range(4), range(90), range(90)):
        levels[level, row, column] = raster[row : row + 2**level, column : column + 2**level].max()
    columns, rows = rng.integers(35, 55, (2, 3, 25)).astype(np.int32)
    none = np.array([NO_PLACE, 0, 0, 0, 0])
    angle, dx, dy, score = search_places(levels, columns, rows, np.array([11, 7]), 0.0, np.zeros(2), none)
    scores = {
        (a, x, y): place_score(raster, columns[a], rows[a], x, y)
        for a, x, y in itertools.product(range(3), range(-11, 12), range(-7, 8))
    }
    assert score == pytest.approx(max(scores.values()))
    assert scores[angle, dx, dy] == pytest.approx(score)
    best = np.array([angle, dx, dy, 0, 2])
    _, _, _, other = search_places(levels, columns, rows, np.array([11, 7]), 0.0, np.zeros(2), best)
    rest = [s for (a, x, y), s in scores.items() if a != angle or abs(x - dx) > 2 or abs(y - dy) > 2]
    assert other == pytest.approx(max(rest))
