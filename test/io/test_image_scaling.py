# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso import PinholeCamera
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.image_scaling import ImageScaler, parse_image_size, scaled_camera

CAMERA = PinholeCamera(425.0, 424.0, 427.6, 236.4, 848, 480)


def test_pixels_are_means_over_areas():
    image = np.random.default_rng(0).uniform(0, 255, (480, 848)).astype(np.float32)
    scaler = ImageScaler(CAMERA, (424, 240))
    scaled = scaler(image)
    assert (scaled.shape, scaled.dtype) == ((240, 424), np.float32)
    np.testing.assert_allclose(scaled, image.reshape(240, 2, 424, 2).mean(axis=(1, 3)), atol=1e-3)


@pytest.mark.parametrize("size", [(424, 240), (636, 360), (640, 300)])
def test_the_camera_sees_the_same_point_at_the_same_share_of_the_image(size):
    """Checked with what the image shows: the middle of a blob, and where the camera projects its direction to."""
    rows, columns = np.mgrid[:480, :848]
    u, v = 601.3, 122.8
    blob = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 12.0**2)).astype(np.float32)
    scaler = ImageScaler(CAMERA, size)
    scaled = scaler(blob)
    rows, columns = np.mgrid[: size[1], : size[0]]
    seen = (columns * scaled).sum() / scaled.sum(), (rows * scaled).sum() / scaled.sum()
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    camera = scaler.camera
    assert (camera.width, camera.height) == size
    np.testing.assert_allclose(seen, [camera.fx * x + camera.cx, camera.fy * y + camera.cy], atol=0.02)


def test_scaling_back_gives_the_camera():
    again = scaled_camera(scaled_camera(CAMERA, (424, 240)), (848, 480))
    np.testing.assert_allclose(again.parameters, CAMERA.parameters, rtol=1e-12)


@pytest.mark.parametrize(
    ("size", "complaint"),
    [((849, 480), "849x480 is larger than the images, 848x480"), ((100, 481), "larger"), ((60, 60), "at least 64x64")],
)
def test_impossible_sizes_are_refused(size, complaint):
    with pytest.raises(InputError, match=complaint):
        ImageScaler(CAMERA, size)


def test_parsing():
    assert parse_image_size("424x240", "--size") == (424, 240)
    for text in ("", "424", "424x", "424 x 240", "424x240x3", "-424x240", "4.5x3", "0x0", "424x0", "00x240"):
        with pytest.raises(InputError, match=f"--size {text}: expected WIDTHxHEIGHT"):
            parse_image_size(text, "--size")
