# SPDX-License-Identifier: BSD-3-Clause
"""Activated points keep their distance, have the right inverse depth and live where they were seen."""

import numpy as np
import pytest
from synthetic import AFFINES, EXPOSURES, POSES, SHARP, Surface, add_keyframe, empty_window, random_pixels

from ceiling_dso_ros.dso.config import ActivationConfig
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.activation import Activator
from ceiling_dso_ros.dso.mapping.activation_kernels import (
    depth_energies,
    new_sums,
    refine_idepths,
    spread,
    stamp_distance,
)
from ceiling_dso_ros.dso.window import trace_outcome
from ceiling_dso_ros.dso.window.candidates import UNSEARCHED_QUALITY
from ceiling_dso_ros.dso.window.pair_geometry import pair_geometry, project_points
from ceiling_dso_ros.dso.window.points import INLIER

SURFACE = Surface(slope=(0.15, -0.1), relief=0.05, texture=SHARP)
FAR = np.int32(1 << 30)
CONFIG = ActivationConfig()


def with_candidates(error=0.05, wanted=300):
    """Three keyframes; candidates of the older two, traced to an interval around a wrong inverse depth."""
    window = empty_window(candidate_points=600)
    for T, affine, exposure in zip(POSES, AFFINES, EXPOSURES):
        add_keyframe(window, T, SURFACE, affine, exposure)
    selector = PixelSelector(window.pool)
    rng = np.random.default_rng(0)
    a = window.candidates.arrays
    for host in range(3):
        first = window.candidates.count
        pixels = selector.select(int(window.keyframes.image_slot[host]), wanted)
        window.candidates.add(pixels, host, window.image(host), window.width)
        new = slice(first, window.candidates.count)
        middle = SURFACE.idepth(POSES[host], a.u[new], a.v[new]) * (1 + rng.uniform(-error, error, new.stop - first))
        a.idepth_min[new], a.idepth_max[new] = middle - 0.01, middle + 0.01
        a.outcome[new], a.interval[new], a.quality[new] = trace_outcome.GOOD, 2.0, 10.0
    return window


def test_distances_are_stamped():
    distance2 = np.full((30, 40), FAR, np.int32)
    stamp_distance(distance2, 10, 12, 5)
    stamp_distance(distance2, 14, 12, 5)
    y, x = np.mgrid[:30, :40]
    first, second = ((x - cx) ** 2 + (y - 12) ** 2 for cx in (10, 14))
    near = [np.maximum(abs(x - cx), abs(y - 12)) <= 5 for cx in (10, 14)]
    expected = np.minimum(np.where(near[0], first, FAR), np.where(near[1], second, FAR))
    np.testing.assert_array_equal(distance2, expected)


@pytest.mark.parametrize("spacing", [0.0, 1.5, 4.0])
def test_spread_keeps_distances(spacing):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 103, 800).astype(np.float32), rng.uniform(0, 83, 800).astype(np.float32)
    min_distance = (spacing * rng.choice([1, 2, 4], 800)).astype(np.float32)
    distance2, reach = np.full((80, 100), FAR, np.int32), int(np.ceil(4 * spacing))
    stamp_distance(distance2, 50, 40, reach)
    accepted = np.zeros(800, bool)
    spread(x, y, min_distance, distance2, reach, accepted)

    taken, expected = [(50, 40)], []
    for i in range(800):
        c, r = int(np.floor(x[i] + 0.5)), int(np.floor(y[i] + 0.5))
        free = all((c - a) ** 2 + (r - b) ** 2 >= min_distance[i] ** 2 for a, b in taken)
        expected.append(free and 0 <= c < 100 and 0 <= r < 80)
        if expected[-1]:
            taken.append((c, r))
    np.testing.assert_array_equal(accepted, expected)
    assert 20 < accepted.sum() < 800


def columns(window, chosen):
    """What the kernels take of chosen candidates: u, v, grey, weight, and the first of each host."""
    a = window.candidates.arrays
    ranges = np.searchsorted(a.host[chosen], np.arange(4))
    return (a.u[chosen], a.v[chosen], a.grey[:, chosen], a.weight[:, chosen]), ranges


def middles(window, chosen):
    a = window.candidates.arrays
    return (0.5 * (a.idepth_min[chosen] + a.idepth_max[chosen])).astype(np.float32)


def refined(window, chosen, iterations):
    pairs = pair_geometry(window.keyframes, 3, window.intrinsics)
    candidates, ranges = columns(window, chosen)
    idepths = middles(window, chosen)
    images = window.pool.buffers
    inliers = refine_idepths(
        *candidates, idepths, ranges, images, 320, 240, window.keyframes, pairs, iterations, 100.0
    )  # fmt: skip
    return idepths, inliers


def test_derivative_by_the_inverse_depth():
    """H and b of the inverse depth against numeric differences of its energy."""
    window = with_candidates(error=0.0)
    pairs = pair_geometry(window.keyframes, 3, window.intrinsics)
    chosen = np.flatnonzero(window.candidates.arrays.host[: window.candidates.count] == 0)
    candidates, ranges = columns(window, chosen)
    sums, inliers = [], []
    for shift in (0.0, 1e-3, -1e-3):
        total, inlier = new_sums(chosen.size), np.zeros((3, chosen.size), np.uint8)
        idepth = middles(window, chosen) + np.float32(0.01 + shift)
        depth_energies(
            *candidates, idepth, ranges, window.pool.buffers, 320, 240, window.keyframes, pairs,
            new_sums(chosen.size), total, inlier,
        )  # fmt: skip
        sums.append(total)
        inliers.append(inlier)
    seen = inliers[0][1:].all(axis=0) & (inliers[0] == inliers[1]).all(axis=0) & (inliers[0] == inliers[2]).all(axis=0)
    assert seen.sum() > 100
    middle, plus, minus = sums
    by_energy = (plus.energy - minus.energy)[seen] / 4e-3 / middle.gradient[seen]
    by_gradient = (plus.gradient - minus.gradient)[seen] / 2e-3 / middle.hessian[seen]
    assert np.median(by_energy) == pytest.approx(1.0, abs=0.06)
    assert np.median(by_gradient) == pytest.approx(1.0, abs=0.06)


def test_refinement_finds_the_true_inverse_depth():
    window = with_candidates(error=0.05)
    a = window.candidates.arrays
    chosen = np.flatnonzero(a.host[: window.candidates.count] < 2)
    idepths, inliers = refined(window, chosen, 6)
    true = np.empty(chosen.size)
    for host in range(2):
        which = a.host[chosen] == host
        true[which] = SURFACE.idepth(POSES[host], a.u[chosen][which], a.v[chosen][which])
    found = np.isfinite(idepths)
    assert found.mean() > 0.7
    error = np.abs(idepths[found] / true[found] - 1)
    assert np.median(error) < 0.002  # the start is off by 0.025
    assert np.quantile(error, 0.9) < 0.02
    assert (inliers.sum(axis=0)[found] > 0).all()
    assert not inliers[a.host[chosen], np.arange(chosen.size)].any()


def test_refinement_refuses_what_is_seen_nowhere():
    window = with_candidates(error=0.0)
    a = window.candidates.arrays
    a.grey[:, :50] = np.linspace(-500, 500, 8, dtype=np.float32)[:, None]
    a.idepth_min[50:100] = a.idepth_max[50:100] = 50.0  # far out of every image
    idepths, inliers = refined(window, np.arange(100), 3)
    assert not np.isfinite(idepths).any()
    assert not inliers.any()


def test_what_was_never_searched_is_not_activated():
    window = with_candidates()
    window.candidates.arrays.quality[:] = UNSEARCHED_QUALITY
    assert Activator(window, 400, CONFIG).activate(window) == 0


def test_activated_points_are_spread_and_right():
    window = with_candidates()
    before = window.candidates.count
    activator = Activator(window, 400, CONFIG)
    activator.spacing = 3.0
    activated = activator.activate(window)
    assert window.points.count == activated
    assert activated > 100
    assert window.candidates.count <= before - activated
    p = window.points.arrays
    assert (p.host[:activated] < 2).all()  # those of the newest keyframe have not been seen elsewhere yet
    true = np.array([SURFACE.idepth(POSES[p.host[i]], p.u[i], p.v[i]) for i in range(activated)])
    assert np.median(np.abs(p.idepth[:activated] / true - 1)) < 0.004
    live, state = window.points.residuals.live, window.points.residuals.state
    np.testing.assert_array_equal(live[:, :activated] > 0, state[:, :activated] == INLIER)
    assert live[:, :activated].any(axis=0).all()

    K = window.keyframes
    pairs = pair_geometry(K, 3, window.intrinsics)
    x, y, _ = (np.empty(activated, np.float32) for _ in range(3))
    project_points(p.u[:activated], p.v[:activated], p.idepth[:activated], p.host[:activated], pairs, 2, x, y, _)
    distances = np.hypot(x[:, None] - x, y[:, None] - y) / 2  # in half-resolution pixels
    np.fill_diagonal(distances, np.inf)
    # depths moved after the spreading and positions were rounded to pixels: a pixel of play
    assert np.quantile(distances.min(axis=1), 0.02) > activator.spacing - 1.0


@pytest.mark.parametrize(
    ("field", "value"),
    [("outcome", trace_outcome.OUTLIER), ("outcome", trace_outcome.UNTRACED), ("interval", 20.0), ("quality", 1.0)],
)
def test_unripe_candidates_are_not_activated(field, value):
    window = with_candidates()
    getattr(window.candidates.arrays, field)[: window.candidates.count] = value
    before = window.candidates.count
    assert Activator(window, 400, CONFIG).activate(window) == 0
    assert window.points.count == 0
    assert window.candidates.count == before


def test_deleted_candidates_go():
    window = with_candidates()
    window.candidates.arrays.outcome[:10] = trace_outcome.DELETED
    window.candidates.arrays.interval[: window.candidates.count] = 20.0  # nothing else is ripe
    before = window.candidates.count
    Activator(window, 400, CONFIG).activate(window)
    assert window.candidates.count == before - 10
    assert not (window.candidates.arrays.outcome[: window.candidates.count] == trace_outcome.DELETED).any()


@pytest.mark.parametrize(("points", "closer"), [(20, True), (100, False)])
def test_spacing_follows_the_number_of_points(points, closer):
    window = empty_window()
    add_keyframe(window, POSES[0], SURFACE)
    u, v = random_pixels(np.random.default_rng(0), points)
    zeros = np.zeros((8, points), np.float32)
    window.points.append(
        u, v, np.ones(points, np.float32), zeros, zeros, np.ones(points, np.float32), np.zeros(points, np.int64),
        np.zeros((5, points), np.uint8),
    )  # fmt: skip
    activator = Activator(window, 50, CONFIG)
    spacings = [activator.spacing]
    for _ in range(12):
        activator.activate(window)
        spacings.append(activator.spacing)
    assert (np.diff(spacings) <= 0).all() if closer else (np.diff(spacings) >= 0).all()
    assert spacings[-1] == pytest.approx(0.0) if closer else spacings[-1] > spacings[0]
