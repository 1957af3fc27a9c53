"""Samples and gradients against scipy."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from ceiling_dso_ros.dso.interpolation import sample, sample_gradient

WIDTH, HEIGHT = 37, 29
IMAGE = np.random.default_rng(0).uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32)
GRAD_Y, GRAD_X = np.gradient(IMAGE.astype(float))  # central differences away from the edge


def positions(margin_low, margin_high, n=200):
    rng = np.random.default_rng(1)
    x = rng.uniform(margin_low, WIDTH - margin_high, n).astype(np.float32)
    y = rng.uniform(margin_low, HEIGHT - margin_high, n).astype(np.float32)
    x[:20], y[:20] = np.floor(x[:20]), np.floor(y[:20])
    return x, y


def at(image, x, y):
    return map_coordinates(image, [y, x], order=1)


def test_sample_is_bilinear():
    x, y = positions(0, 1.01)
    ours = [sample(IMAGE.ravel(), WIDTH, a, b) for a, b in zip(x, y)]
    assert ours == pytest.approx(at(IMAGE, x, y), abs=1e-3)


def test_gradient_is_interpolated_central_differences():
    x, y = positions(1, 2.01)
    ours = np.array([sample_gradient(IMAGE.ravel(), WIDTH, a, b) for a, b in zip(x, y)])
    np.testing.assert_allclose(ours[:, 0], at(IMAGE, x, y), atol=1e-3)
    np.testing.assert_allclose(ours[:, 1], at(GRAD_X, x, y), atol=1e-3)
    np.testing.assert_allclose(ours[:, 2], at(GRAD_Y, x, y), atol=1e-3)


def test_whole_pixels_are_exact():
    value, grad_x, grad_y = sample_gradient(IMAGE.ravel(), WIDTH, np.float32(7), np.float32(5))
    assert value == IMAGE[5, 7]
    assert grad_x == np.float32(0.5) * (IMAGE[5, 8] - IMAGE[5, 6])
    assert grad_y == np.float32(0.5) * (IMAGE[6, 7] - IMAGE[4, 7])
