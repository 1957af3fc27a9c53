# SPDX-License-Identifier: BSD-3-Clause
import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.lens_models import LensCamera

INTRINSICS = (425.3, 424.9, 427.6, 236.4)
SIZE = (848, 480)

RADTAN = {
    "RadTan": (-0.283, 0.074, 1.2e-3, -0.9e-3),
    "plumb_bob": (-0.283, 0.074, 1.2e-3, -0.9e-3, -0.011),
    "rational_polynomial": (0.41, -0.12, 4e-4, 5e-4, 0.02, 0.75, -0.08, 0.03),
}
EQUIDISTANT = (-0.0134, 0.0421, -0.0387, 0.0066)


def a_lens(model, distortion):
    return LensCamera(model, *INTRINSICS, distortion, *SIZE)


def some_points(count=500):
    rng = np.random.default_rng(7)
    points = rng.uniform([-3, -2, 2], [3, 2, 6], size=(count, 3))
    points[0, :2] = 0  # on the optical axis
    return points


@pytest.mark.parametrize("distortion", RADTAN.values(), ids=RADTAN.keys())
def test_radtan_projects_as_opencv(distortion):
    lens = a_lens("RadTan", distortion)
    expected, _ = cv2.projectPoints(some_points(), np.zeros(3), np.zeros(3), lens.matrix, np.array(distortion))
    np.testing.assert_allclose(lens.project(some_points()), expected[:, 0], atol=1e-9)


def test_pinhole_projects_as_opencv():
    lens = a_lens("Pinhole", ())
    expected, _ = cv2.projectPoints(some_points(), np.zeros(3), np.zeros(3), lens.matrix, None)
    np.testing.assert_allclose(lens.project(some_points()), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("distortion", [EQUIDISTANT, (0.0, 0.0, 0.0, 0.0)])
def test_equidistant_projects_as_opencv(distortion):
    lens = a_lens("EquiDistant", distortion)
    expected, _ = cv2.fisheye.projectPoints(
        some_points()[:, None], np.zeros(3), np.zeros(3), lens.matrix, np.array(distortion)
    )
    np.testing.assert_allclose(lens.project(some_points()), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("omega", [0.2, 0.93, 1.3])
def test_fov_is_undone_by_its_published_inverse(omega):
    points = some_points()
    lens = a_lens("FOV", (omega,))
    distorted = (lens.project(points) - [lens.cx, lens.cy]) / [lens.fx, lens.fy]

    radius = np.linalg.norm(distorted, axis=1)[1:]  # the first point is on the axis
    undistorted_radius = np.tan(radius * omega) / (2 * np.tan(omega / 2))
    rays = distorted[1:] * (undistorted_radius / radius)[:, None]
    np.testing.assert_allclose(rays, points[1:, :2] / points[1:, 2:], atol=1e-12)
    np.testing.assert_allclose(distorted[0], 0.0, atol=1e-12)


def test_fov_follows_its_formula():
    lens = a_lens("FOV", (0.9,))
    x, y = 0.4, -0.3  # r = 0.5
    ratio = np.arctan(2 * 0.5 * np.tan(0.45)) / (0.9 * 0.5)
    expected = [[lens.fx * ratio * x + lens.cx, lens.fy * ratio * y + lens.cy]]
    np.testing.assert_allclose(lens.project(np.array([[x, y, 1.0]])), expected, atol=1e-9)


def test_a_lens_that_folds_back_does_not_see_what_lies_beyond():
    lens = a_lens("RadTan", (-0.3, 0.0, 0.0, 0.0))
    fold = np.sqrt(1 / 0.9)  # d/dr (r - 0.3 r^3) = 0
    assert lens.max_radius == pytest.approx(fold, rel=2e-3)
    beyond = np.array([1.8])
    u, _ = lens.pixels(beyond, np.zeros(1))
    assert 0 < u[0] < lens.width, "the bare formula puts it into the image"
    assert not lens.sees(beyond, np.zeros(1))[0]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"fx": float("nan")}, "not finite"),
        ({"fx": 0.0}, "must be positive"),
        ({"width": 0}, "must be positive"),
    ],
)
def test_impossible_cameras_are_refused(changes, complaint):
    fields = {"fx": 425.3, "fy": 424.9, "cx": 427.6, "cy": 236.4, "width": 848, "height": 480, **changes}
    with pytest.raises(ValueError, match=complaint):
        LensCamera("Pinhole", distortion=(), **fields)
