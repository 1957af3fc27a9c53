# SPDX-License-Identifier: BSD-3-Clause
"""Samples and gradients against their definition."""

import numpy as np
import pytest
from samples import sample as sample_by_definition
from scipy.ndimage import map_coordinates

from ceiling_dso_ros.dso.images.interpolation import sample, sample_gradient

WIDTH, HEIGHT = 37, 29
IMAGE = np.random.default_rng(0).uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32)


def positions(margin_low, margin_high, n=200):
    rng = np.random.default_rng(1)
    x = rng.uniform(margin_low, WIDTH - margin_high, n).astype(np.float32)
    y = rng.uniform(margin_low, HEIGHT - margin_high, n).astype(np.float32)
    x[:20], y[:20] = np.floor(x[:20]), np.floor(y[:20])
    return x, y


def test_sample_is_bilinear():
    x, y = positions(0, 1.01)
    ours = [sample(IMAGE.ravel(), WIDTH, a, b) for a, b in zip(x, y)]
    assert ours == pytest.approx(map_coordinates(IMAGE, [y, x], order=1), abs=1e-3)


def test_value_is_cubic_and_gradient_is_interpolated_central_differences():
    x, y = positions(1, 2.01)
    ours = np.array([sample_gradient(IMAGE.ravel(), WIDTH, a, b) for a, b in zip(x, y)])
    np.testing.assert_allclose(ours.T, sample_by_definition(IMAGE, x, y), atol=1e-3)


def test_value_beside_the_gradient_is_exact_on_surfaces_of_second_order():
    def surface(x, y):
        return 100 + 3 * x - 2 * y + 0.3 * x * x - 0.2 * y * y + 0.1 * x * y

    image = surface(*np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))).astype(np.float32)
    x, y = positions(1, 2.01)
    ours = np.array([sample_gradient(image.ravel(), WIDTH, a, b)[0] for a, b in zip(x, y)])
    np.testing.assert_allclose(ours, surface(x.astype(float), y.astype(float)), atol=1e-3)
    linear = np.array([sample(image.ravel(), WIDTH, a, b) for a, b in zip(x, y)])
    assert abs(linear - surface(x, y)).max() > 0.02  # which the bilinear sample is not


def test_whole_pixels_are_exact():
    value, grad_x, grad_y = sample_gradient(IMAGE.ravel(), WIDTH, np.float32(7), np.float32(5))
    assert value == IMAGE[5, 7]
    assert grad_x == np.float32(0.5) * (IMAGE[5, 8] - IMAGE[5, 6])
    assert grad_y == np.float32(0.5) * (IMAGE[6, 7] - IMAGE[4, 7])
