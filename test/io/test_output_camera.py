# SPDX-License-Identifier: BSD-3-Clause
import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.io.output_camera import crop_camera, full_camera

LENSES = {
    "pinhole": LensCamera("Pinhole", 425.3, 424.9, 427.6, 236.4, (), 848, 480),
    "barrel": LensCamera("RadTan", 425.3, 424.9, 427.6, 236.4, (-0.283, 0.074, 1.2e-3, -0.9e-3), 848, 480),
    "pincushion": LensCamera("RadTan", 425.3, 424.9, 427.6, 236.4, (0.12, 0.05, -1e-3, 2e-3), 848, 480),
    "folding": LensCamera("RadTan", 525.0, 525.0, 319.5, 239.5, (-0.35, 0.0, 0.0, 0.0), 640, 480),
    "rational": LensCamera("RadTan", 610, 610, 637, 368, (0.47, -2.6, 6e-4, -2e-4, 1.56, 0.35, -2.42, 1.48), 1280, 720),
    "fisheye": LensCamera("EquiDistant", 286.0, 286.0, 427.6, 396.4, (-0.013, 0.042, -0.039, 0.007), 848, 800),
    "fov": LensCamera("FOV", 448.0, 614.0, 634.0, 511.0, (0.93,), 1280, 1024),
}


@pytest.fixture(params=LENSES.values(), ids=LENSES.keys())
def lens(request):
    return request.param


def seen(lens, camera, margin=(0, 0, 0, 0)):
    """Whether each pixel of the output, and of margins (left, right, top, bottom) around it, lies in the raw image."""
    left, right, top, bottom = margin
    x = (np.arange(-left, camera.width + right) - camera.cx) / camera.fx
    y = (np.arange(-top, camera.height + bottom) - camera.cy) / camera.fy
    rounding = 1 - 1e-6
    return lens.sees(*np.meshgrid(rounding * x, rounding * y))


@pytest.mark.parametrize("size", [(640, 480), (848, 480), (320, 320)])
def test_crop_shows_nothing_but_the_image(lens, size):
    assert seen(lens, crop_camera(lens, *size)).all()


def test_crop_cannot_grow_on_any_side(lens):
    camera = crop_camera(lens, 640, 480)
    for side in range(4):
        margin = [0, 0, 0, 0]
        margin[side] = 1
        assert not seen(lens, camera, margin).all(), f"one more pixel fits on side {side}"


def test_crop_of_a_barrel_is_as_large_as_opencvs():
    lens = LENSES["barrel"]
    camera = crop_camera(lens, 848, 480)
    opencv, _ = cv2.getOptimalNewCameraMatrix(lens.matrix, np.array(lens.distortion), (848, 480), 0)
    np.testing.assert_allclose(camera.parameters, opencv[[0, 1, 0, 1], [0, 1, 2, 2]], rtol=0.02)


@pytest.mark.parametrize("name", ["pinhole", "barrel", "pincushion", "rational"])
def test_full_shows_the_whole_border(name):
    lens = LENSES[name]
    camera = full_camera(lens, 640, 480)
    x = (np.arange(640) - camera.cx) / camera.fx
    y = (np.arange(480) - camera.cy) / camera.fy
    u, v = lens.pixels(*np.meshgrid(x, y))
    pixel = 1.5 * max(lens.fx / camera.fx, lens.fy / camera.fy)  # of the output, in raw pixels
    raw_border = [(u0, v0) for u0 in (0, lens.width / 2, lens.width - 1) for v0 in (0, lens.height - 1)]
    raw_border += [(u0, lens.height / 2) for u0 in (0, lens.width - 1)]
    for u0, v0 in raw_border:
        assert np.hypot(u - u0, v - v0).min() < pixel, f"({u0}, {v0}) is missing"
    assert not seen(lens, camera, (1, 0, 0, 0))[:, 0].any(), "nothing is left beyond the border"


@pytest.mark.parametrize("name", ["fisheye", "fov"])
def test_full_of_a_wide_lens_ends_at_eighty_degrees(name):
    camera = full_camera(LENSES[name], 640, 480)
    assert np.degrees(np.arctan(camera.cx / camera.fx)) <= 80 + 1e-9
    assert np.degrees(np.arctan((camera.width - 1 - camera.cx) / camera.fx)) <= 80 + 1e-9


def test_a_pinhole_of_the_same_size_stays_as_it_is():
    for choose in (crop_camera, full_camera):
        camera = choose(LENSES["pinhole"], 848, 480)
        assert camera.parameters.tolist() == [425.3, 424.9, 427.6, 236.4]


def test_coefficients_of_no_lens():
    lens = LensCamera("RadTan", 425.3, 424.9, 427.6, 236.4, (-1e9, 0.0, 0.0, 0.0), 848, 480)
    with pytest.raises(ValueError, match="the distortion coefficients are those of no lens"):
        crop_camera(lens, 848, 480)
