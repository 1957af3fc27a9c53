# SPDX-License-Identifier: BSD-3-Clause
"""Number, spread and reproducibility of the selected pixels."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from synthetic import SHARP, Surface

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import (
    BLOCK,
    BORDER,
    MEDIAN_MARGIN,
    PixelSelector,
    block_thresholds,
    cell_direction,
    squared_gradient,
)

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[4] / "shared" / "data"))
SIZES = [(320, 240), (424, 240), (640, 480), (848, 480)]


def selector_of(image):
    height, width = image.shape
    pool = PyramidPool(PinholeCamera(200, 200, width / 2, height / 2, width, height), 3)
    return PixelSelector(pool), pool, pool.build(image)


def textured(width, height, seed=1):
    camera = PinholeCamera(200, 200, width / 2, height / 2, width, height)
    surface = Surface(slope=(0.1, 0.2), texture=type(SHARP)(seed=seed, shortest=0.04, contrast=40.0, waves=24))
    return np.clip(surface.render(se3.exp(np.zeros(6)), camera), 0, 255)


def real_image(recording, number, size):
    folder = DATA / recording / "images"
    if not folder.is_dir():
        pytest.skip(f"recording {recording} is not there")
    image = cv2.imread(str(sorted(folder.iterdir())[number]), cv2.IMREAD_GRAYSCALE)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("wanted", [300, 600, 1500, 2000])
@pytest.mark.parametrize("size", SIZES)
def test_number_on_a_synthetic_texture(size, wanted):
    selector, _, slot = selector_of(textured(*size))
    assert selector.select(slot, wanted).u.size == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("wanted", [600, 1500, 2000])
@pytest.mark.parametrize("size", [(320, 240), (640, 480)])
@pytest.mark.parametrize("number", [0, 150, 300])
@pytest.mark.parametrize("recording", ["tum_fr1_xyz", "ceiling_loops"])
def test_number_on_real_images(recording, number, size, wanted):
    selector, _, slot = selector_of(real_image(recording, number, size))
    assert selector.select(slot, wanted).u.size == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("wanted", [10, 5000])
def test_number_far_from_the_usual_in_one_call(wanted):
    selector, _, slot = selector_of(textured(640, 480))
    assert selector.select(slot, wanted).u.size == pytest.approx(wanted, rel=0.1)


def test_same_image_gives_the_same_pixels():
    image = textured(320, 240)
    results = []
    for _ in range(2):
        selector, _, slot = selector_of(image)
        results.append(selector.select(slot, 700))
    for name in ("u", "v", "kind"):
        np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name))


def test_pixels_are_distinct_whole_sorted_and_off_the_border():
    selector, _, slot = selector_of(textured(320, 240))
    pixels = selector.select(slot, 2000)
    index = pixels.v * 320 + pixels.u
    assert (np.diff(index) > 0).all()
    assert (pixels.u == np.round(pixels.u)).all()
    assert pixels.u.min() >= BORDER
    assert pixels.u.max() < 320 - BORDER
    assert pixels.v.min() >= BORDER
    assert pixels.v.max() < 240 - BORDER
    assert pixels.u.dtype == pixels.v.dtype == pixels.kind.dtype == np.float32


def test_coarse_cells_fill_where_the_texture_is_weak():
    """Strong texture left; fading to nothing on the right: there only lower thresholds find something."""
    image = textured(640, 480)
    fade = np.clip(1.2 - np.arange(640) / 500.0, 0.02, 1.0)[None, :]
    selector, _, slot = selector_of((120 + fade * (image - 120)).astype(np.float32))
    kinds = selector.select(slot, 1500).kind
    assert set(np.unique(kinds)) == {1, 2, 4}


def test_points_are_spread_over_the_whole_image():
    selector, _, slot = selector_of(textured(640, 480))
    pixels = selector.select(slot, 1500)
    counts, _, _ = np.histogram2d(pixels.v, pixels.u, bins=(4, 5), range=((0, 480), (0, 640)))
    assert counts.min() > 0.4 * 1500 / 20


def test_chosen_pixels_have_a_gradient_above_the_threshold_of_their_block():
    image = textured(320, 240)
    selector, _, slot = selector_of(image)
    pixels = selector.select(slot, 700)
    gradient2 = np.empty(image.size, np.float32)
    squared_gradient(image.ravel(), 320, 240, gradient2)
    thresholds = block_thresholds(gradient2, 320, 240)
    u, v = pixels.u.astype(int), pixels.v.astype(int)
    fine = pixels.kind == 1
    assert fine.sum() > 100
    assert (gradient2[v * 320 + u] > thresholds[v // BLOCK, u // BLOCK])[fine].all()


@pytest.mark.parametrize("image", [np.zeros((240, 320)), np.full((240, 320), 255.0), np.full((240, 320), np.nan)])
def test_nothing_to_select_is_no_error(image):
    selector, pool, _ = selector_of(np.zeros((240, 320), np.float32))
    assert selector.select(pool.build(image.astype(np.float32)), 1000).u.size == 0
    assert selector.select(pool.build(textured(320, 240)), 1000).u.size == pytest.approx(1000, rel=0.1)


def test_little_texture_gives_fewer_points():
    image = np.full((240, 320), 100, np.float32)
    image[100:130, 200:240] += np.random.default_rng(0).uniform(0, 60, (30, 40)).astype(np.float32)
    selector, _, slot = selector_of(image)
    pixels = selector.select(slot, 2000)
    assert 20 < pixels.u.size < 2000
    assert pixels.u.min() > 190
    assert pixels.u.max() < 250


def test_squared_gradient_is_numpys():
    image = np.random.default_rng(0).uniform(0, 255, (20, 30)).astype(np.float32)
    result = np.empty(600, np.float32)
    squared_gradient(image.ravel(), 30, 20, result)
    grad_y, grad_x = np.gradient(image)
    expected = np.zeros((20, 30))
    expected[1:-1, 1:-1] = (grad_x**2 + grad_y**2)[1:-1, 1:-1]
    np.testing.assert_allclose(result.reshape(20, 30), expected, rtol=1e-5)


def test_threshold_is_the_median_of_the_block_plus_the_margin():
    """Gradient 3 on the left of a border between blocks and 11 on its right: smoothing mixes one in three columns."""
    width, height = 6 * BLOCK, 3 * BLOCK
    gradient = np.where(np.arange(width) < width // 2, 3.5, 11.5).astype(np.float32)
    thresholds = block_thresholds(np.tile(gradient**2, height), width, height)
    left, right = 3 + MEDIAN_MARGIN, 11 + MEDIAN_MARGIN
    mixed = [left, left, (2 * left + right) / 3, (left + 2 * right) / 3, right, right]
    np.testing.assert_allclose(thresholds, np.tile(np.square(mixed), (3, 1)), rtol=1e-5)


def test_directions_of_cells_are_spread():
    directions = [cell_direction(x, y, level) for x in range(4, 300, 3) for y in range(4, 200, 3) for level in range(3)]
    counts = np.bincount(directions, minlength=16)
    assert counts.size == 16
    assert counts.min() > 0.7 * counts.mean()
