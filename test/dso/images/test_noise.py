# SPDX-License-Identifier: BSD-3-Clause
"""The noise of an image, and its smoothing."""

import cv2
import numpy as np
import pytest
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso.images.noise import TAPS, noise_level, smooth_image
from ceiling_dso_ros.dso.images.pyramid import PyramidPool

SCENE = Surface(slope=(0.1, -0.1), relief=0.1, texture=SHARP).render(np.eye(4))


def noisy(sigma, image=SCENE, seed=0):
    return (image + np.random.default_rng(seed).normal(0.0, sigma, image.shape)).astype(np.float32)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0])
def test_noise_of_a_plain_surface_is_measured(sigma):
    plain = np.full((CAMERA.height, CAMERA.width), 120.0)
    assert noise_level(noisy(sigma, plain)) == pytest.approx(sigma, rel=0.1)
    assert noise_level(np.clip(noisy(sigma, plain), 0, 255).astype(np.uint8)) == pytest.approx(sigma, rel=0.15)


def test_noise_grows_with_the_scene_s_own():
    levels = [noise_level(noisy(sigma)) for sigma in (0.0, 2.0, 4.0)]
    assert levels[0] < levels[1] < levels[2]


@pytest.mark.parametrize("grey", [0.0, 255.0])
def test_black_and_white_hide_their_noise(grey):
    assert noise_level(np.full((CAMERA.height, CAMERA.width), grey, np.float32)) is None


def test_smoothing_is_a_gaussian():
    image = noisy(3.0)
    smoothed = np.empty_like(image)
    smooth_image(image, np.empty_like(image), smoothed)
    expected = cv2.sepFilter2D(image, -1, TAPS, TAPS, borderType=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(smoothed, expected, atol=1e-3)
    assert TAPS.sum() == pytest.approx(1.0)


def test_interpolation_changes_the_noise_of_a_smoothed_image_little():
    """The reason why it is smoothed: half-way between two pixels independent noise has half the variance."""
    plain = np.full((CAMERA.height, CAMERA.width), 120.0)
    image = noisy(3.0, plain)
    smoothed = np.empty_like(image)
    smooth_image(image, np.empty_like(image), smoothed)
    shares = [np.var(0.5 * (x[:, 1:] + x[:, :-1])) / np.var(x) for x in (image, smoothed)]
    assert shares[0] == pytest.approx(0.5, abs=0.02)
    assert shares[1] > 0.8


def test_a_pyramid_is_built_of_the_smoothed_image():
    pool = PyramidPool(CAMERA, 2)
    image = noisy(3.0)
    raw, smoothed = pool.build(image), pool.build(image, smooth=True)
    np.testing.assert_array_equal(pool.level(raw, 0), image.ravel())
    difference = pool.level(smoothed, 0) - image.ravel()
    assert 1.0 < np.std(difference) < 4.0
