# SPDX-License-Identifier: BSD-3-Clause
"""The vignette that is found from what keyframes show of the same points."""

import numpy as np
import pytest
from synthetic import CAMERA, HOLD_FIRST, SHARP, Surface, add_points, empty_window, random_pixels

from ceiling_dso_ros.dso.adjustment.bundle_adjustment import BundleAdjustment
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.selection import SelectedPixels
from ceiling_dso_ros.dso.images.vignette import Vignette
from ceiling_dso_ros.dso.mapping import vignetting
from ceiling_dso_ros.dso.mapping.vignetting import VignetteEstimator
from ceiling_dso_ros.dso.window.candidates import CandidateTable

BLOCK = 4
TRUE = (-0.25, -0.1)
HOLD_INTRINSICS = [2e6] * 4
SURFACE = Surface(slope=(-0.2, 0.1), texture=SHARP)
AFFINES = ((0.0, 0.0), (0.05, 3.0), (-0.04, -2.0), (0.02, 1.0))


def seen_window(seed, coefficients=TRUE, applied=None):
    """Four keyframes through a lens with a vignette."""
    rng = np.random.default_rng(seed)
    window = empty_window(max_keyframes=4, active_points=800)
    lens = Vignette(CAMERA, coefficients)
    start = np.array([*rng.uniform(-1.0, 1.0, 2), 0.0, 0.0, 0.0, 0.0])  # elsewhere on the surface
    way = np.array([*rng.uniform(-0.1, 0.1, 2), 0.0, 0.0, 0.0, 0.1])
    poses = [se3.exp(i * way) @ se3.exp(start) for i in range(4)]
    for number, (T, affine) in enumerate(zip(poses, AFFINES)):
        grey = SURFACE.render(T, affine=affine)
        grey = grey if lens.inverse is None else grey / lens.inverse
        grey += rng.normal(0.0, 1.0, grey.shape).astype(np.float32)
        slot = window.pool.build(grey, vignette=applied)
        window.add_keyframe(number, number, slot, T, np.array(affine), 1.0)
    for host, T in enumerate(poses):
        u, v = random_pixels(rng, 150)
        add_points(window, host, u, v, SURFACE.idepth(T, u, v))
    return window


def estimated(windows):
    """The change that the newest keyframes of all windows together ask for."""
    estimator = VignetteEstimator(CAMERA, block=len(windows))
    for window in windows:
        estimator._add_keyframe(window)
    return np.linalg.solve(estimator._H, estimator._g)


def test_it_is_found_to_a_percent_of_the_light():
    change = estimated([seen_window(seed) for seed in range(6)])
    assert vignetting.largest_log(change - TRUE) < 0.02


def test_geometry_that_makes_up_for_it_does_not_hide_it():
    """The adjustment moves points, at edges, to where they look as bright as in their host: that takes two thirds."""
    windows = [seen_window(seed) for seed in range(6)]
    for window in windows:
        held = np.arange(window.prior.b.size)[: len(HOLD_INTRINSICS) + len(HOLD_FIRST)]
        window.prior.H[held, held] = HOLD_INTRINSICS + HOLD_FIRST
        BundleAdjustment(window, OdometryConfig().optimization).optimize(window)
    assert vignetting.largest_log(estimated(windows) - TRUE) < 0.25 * -sum(TRUE)


def test_what_is_corrected_already_needs_no_change():
    change = estimated([seen_window(seed, applied=Vignette(CAMERA, TRUE)) for seed in range(6)])
    assert vignetting.largest_log(change) < 0.02


def test_images_and_points_of_the_window_are_corrected_when_it_is_found():
    estimator, windows = VignetteEstimator(CAMERA, BLOCK), [seen_window(seed) for seed in range(40)]
    for window in windows:
        estimator.update(window)
        if any(estimator.vignette.coefficients):
            break
    assert vignetting.largest_log(np.subtract(estimator.vignette.coefficients, TRUE)) < 0.02
    for slot in range(window.count):
        assert window.pool.vignette(int(window.keyframes.image_slot[slot])) is estimator.vignette
    n = window.points.count
    for host in range(window.count):
        of_host = window.points.arrays.host[:n] == host
        table = CandidateTable(n)
        pixels = pixels_of(window, of_host)
        table.add(pixels, 0, window.image(host), window.width)
        assert np.allclose(
            table.arrays.grey[:, : pixels.u.size], window.points.arrays.grey[:, :n][:, of_host], atol=0.05
        )


def pixels_of(window, chosen):
    arrays, n = window.points.arrays, window.points.count
    return SelectedPixels(arrays.u[:n][chosen], arrays.v[:n][chosen], arrays.kind[:n][chosen])


def test_a_lens_without_vignetting_is_left_alone():
    estimator = VignetteEstimator(CAMERA, BLOCK)
    for seed in range(40):
        estimator.update(seen_window(seed, coefficients=(0.0, 0.0)))
    assert estimator.vignette.coefficients == (0.0, 0.0)


@pytest.mark.parametrize(("blocks", "measured"), [(0, 3 * BLOCK), (vignetting.SETTLED, 3)])
def test_once_nothing_changes_one_keyframe_of_a_block_is_enough(monkeypatch, blocks, measured):
    estimator, windows = VignetteEstimator(CAMERA, BLOCK), []
    estimator._blocks = blocks
    monkeypatch.setattr(estimator, "_add_keyframe", windows.append)
    monkeypatch.setattr(estimator, "significant_change", lambda: None)
    window = seen_window(0)
    for _ in range(3 * BLOCK):
        estimator.update(window)
    assert len(windows) == measured


def test_a_young_map_tells_nothing():
    window = seen_window(0)
    estimator = VignetteEstimator(CAMERA, block=window.count + 1)
    for _ in range(2 * estimator._block):
        estimator.update(window)
    assert estimator._keyframes == estimator._blocks == 0


@pytest.mark.parametrize("blocks", [2, 3, 8])
def test_chance_changes_it_as_seldom_as_stated(monkeypatch, blocks):
    """Blocks that scatter around no change, with a variance that nobody told."""
    monkeypatch.setattr(vignetting, "CHANCE", 0.1)
    monkeypatch.setattr(vignetting, "NOTICEABLE", 0.0)
    rng, changes, trials = np.random.default_rng(0), 0, 2000
    H = 1e6 * np.array([[2.0, 1.2], [1.2, 1.0]])
    for _ in range(trials):
        estimator = VignetteEstimator(CAMERA, block=1)
        for g in rng.multivariate_normal(np.zeros(2), 9.0 * H, blocks):
            estimator._H, estimator._g = H.copy(), g
            estimator.close_block()
        changes += estimator.significant_change() is not None
    assert changes / trials == pytest.approx(0.1, abs=0.02)


def test_a_direction_that_no_block_tells_is_held_by_the_prior():
    estimator = VignetteEstimator(CAMERA, block=1)
    strong, weak = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    for number in range(6):
        H = 1e8 * np.outer(strong, strong) + 2e4 * np.outer(weak, weak)
        g = H @ (-0.1 * strong) + 2e4 * (3.0 + (-1.0) ** number) * weak  # the weak direction claims coefficients of 3
        estimator._H, estimator._g = H, g
        estimator.close_block()
    change = estimator.significant_change()
    assert change @ strong / 2 == pytest.approx(-0.1, abs=0.01)
    assert abs(change @ weak) / 2 < 3.0
