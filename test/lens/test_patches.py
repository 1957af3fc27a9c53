# SPDX-License-Identifier: BSD-3-Clause
"""Patches are found to a fraction of a pixel, and the information says to which."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ceiling_dso_ros.lens.patch_kernels import align_patches

WIDTH, HEIGHT = 160, 120
SHIFT = np.array([2.37, -1.61])
TURN = 0.15


def waves(x, y, seed=0):
    numbers = np.random.default_rng(seed).normal(size=(24, 3)) * (0.5, 0.5, 3.0)
    return 120.0 + 8.0 * sum(np.cos(a * x + b * y + phase) for a, b, phase in numbers)


def images(noise=0.0, gain=1.0, offset=0.0):
    """A picture, and the same turned about (80, 60) and shifted."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    c, s = np.cos(TURN), np.sin(TURN)
    dx, dy = x - 80.0 - SHIFT[0], y - 60.0 - SHIFT[1]
    rng = np.random.default_rng(1)
    pair = waves(x, y), gain * waves(c * dx + s * dy + 80.0, -s * dx + c * dy + 60.0) + offset
    return [(image + noise * rng.normal(size=image.shape)).astype(np.float32).ravel() for image in pair]


def aligned(pair, start_error=(0.7, -0.6)):
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(50, 111, 6), np.arange(40, 81, 6)))
    pixels = np.column_stack([u, v]).astype(np.int64)
    warp = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
    true = (pixels - [80.0, 60.0]) @ warp.T + [80.0, 60.0] + SHIFT
    warps = np.tile(warp, (len(pixels), 1, 1))
    return true, align_patches(*pair, WIDTH, HEIGHT, pixels, warps, true + start_error)


def test_positions_with_another_brightness():
    true, (positions, _, _) = aligned(images(gain=1.4, offset=-20.0))
    assert np.isfinite(positions).all()
    assert np.abs(positions - true).max() < 0.02


@pytest.mark.parametrize("noise", [2.0, 5.0])
def test_errors_are_about_what_the_information_says(noise):
    true, (positions, information, own) = aligned(images(noise=noise))
    found = np.isfinite(positions[:, 0])
    assert found.mean() > 0.9
    error = (positions - true)[found]
    covariance = np.linalg.inv(information[found]) + np.linalg.inv(own[found])  # of both images
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    assert 1.0 < square.mean() < 3.5  # two degrees of freedom


def test_what_is_not_there_is_not_found():
    host, _ = images()
    other = gaussian_filter(np.random.default_rng(5).normal(size=(HEIGHT, WIDTH)), 1.5).astype(np.float32).ravel() * 200
    _, (positions, _, _) = aligned((host, other))
    assert np.isfinite(positions[:, 0]).mean() < 0.1
    _, (positions, _, _) = aligned((np.full_like(host, 7.0), host))
    assert not np.isfinite(positions).any()
