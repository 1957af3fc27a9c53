# SPDX-License-Identifier: BSD-3-Clause
import cv2
import numpy as np
import pytest

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.rendering.geometry import quad
from ceiling_dso_ros.simulation.rendering.materials import Material
from ceiling_dso_ros.simulation.rendering.renderer import LENS_BLUR_PX, SAMPLE_TIMES, SAMPLES, TEXTURE_SAMPLES, Renderer
from ceiling_dso_ros.simulation.rendering.scene import Hall, build_scene

CAMERA = PinholeCamera(100.0, 100.0, 63.5, 47.5, 128, 96)
HEIGHT_M = 4.0


@pytest.fixture(scope="module")
def edge():
    """A ceiling that is bright left of x = 0 and dark right of it."""
    bright, dark = Material(0.8, luminous=True), Material(0.2, luminous=True)
    surfaces = [quad((x, 10, HEIGHT_M), (10, 0, 0), (0, -20, 0), m) for x, m in ((-10, bright), (0, dark))]
    return Renderer(build_scene(Hall(surfaces, [], (20.0, 20.0), Obstacles(np.zeros((0, 2, 2)))), 100.0, 0), CAMERA)


def poses(x_of_sample):
    T = np.tile(np.eye(4), (len(SAMPLE_TIMES), 1, 1))
    T[:, 0, 3] = x_of_sample
    return T


def edge_position_px(picture):
    """Where an ideal edge would be that lets the same light through, per row."""
    return ((picture - 0.2) / 0.6).sum(axis=1) - 0.5


def test_samples_are_an_orthogonal_latin_hypercube():
    levels = (np.arange(16) - 7.5) / 16
    for column in SAMPLES.T:
        np.testing.assert_allclose(np.sort(column), levels)
    np.testing.assert_allclose(SAMPLES.T @ SAMPLES, np.eye(3) * (levels**2).sum(), atol=1e-12)


def test_texture_samples_have_the_mean_and_the_variance_of_pixel_and_exposure():
    np.testing.assert_allclose(TEXTURE_SAMPLES.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(TEXTURE_SAMPLES.T @ TEXTURE_SAMPLES / 4, np.eye(3) / 12, atol=1e-12)


@pytest.mark.parametrize("shift_px", [0.0, 0.25, 0.5, 0.8])
def test_edges_are_where_they_belong_to_a_fraction_of_a_pixel(edge, shift_px):
    picture = edge.expose(poses(shift_px * HEIGHT_M / 100.0))
    np.testing.assert_allclose(edge_position_px(picture), 63.5 - shift_px, atol=0.04)


def test_motion_blurs_along_its_way_around_the_middle_of_the_exposure(edge):
    still = edge.expose(poses(0.0))
    moving = edge.expose(poses(6.0 * SAMPLE_TIMES * HEIGHT_M / 100.0))
    np.testing.assert_allclose(edge_position_px(moving), 63.5, atol=0.05)
    slope = np.abs(np.diff(moving[48]))
    assert 5 <= (slope > 0.05).sum() <= 8, "the edge is six pixels wide"
    assert (np.abs(np.diff(still[48])) > 0.05).sum() <= 3


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5])
def test_a_still_edge_has_the_blur_of_pixel_and_lens(edge, share):
    profile = -np.diff(edge.expose(poses(share * HEIGHT_M / 100.0))[48])
    profile /= profile.sum()
    position = np.arange(len(profile))
    variance = (profile * position**2).sum() - (profile * position).sum() ** 2
    lens = (cv2.getGaussianKernel(5, LENS_BLUR_PX)[:, 0] * (np.arange(5) - 2) ** 2).sum()
    assert variance == pytest.approx(share * (1 - share) + lens, rel=0.1)  # the pixel that it divides, and the lens


def test_inverse_depth_is_along_the_optical_axis(edge):
    T = np.eye(4)
    np.testing.assert_allclose(edge.inverse_depth(T), 1 / HEIGHT_M, rtol=1e-6)
    tilt = 0.2
    T[1:3, 1:3] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    y = (np.arange(96) - 47.5) / 100.0
    expected = (np.sin(tilt) * y + np.cos(tilt)) / HEIGHT_M
    np.testing.assert_allclose(edge.inverse_depth(T), np.tile(expected[:, None], (1, 128)), rtol=1e-5)
