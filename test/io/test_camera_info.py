# SPDX-License-Identifier: BSD-3-Clause
import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.camera_info import (
    Window,
    calibration_from_camera_info,
    camera_info_fields,
    distorted_though_rectified,
)
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor

K = [425.3, 0.0, 427.6, 0.0, 424.9, 236.4, 0.0, 0.0, 1.0]
P = [400.0, 0, 420.0, -20.0, 0, 401.0, 240.0, 0, 0, 0, 1, 0]
MILD = [-0.1, 0.01, 0.001, -0.001, 0.0]  # cv2.undistortPoints converges up to the corners
BARREL = [-0.28, 0.07, 0.001, -0.001, -0.01]


@pytest.mark.parametrize("D", [[], [0.0] * 5, np.zeros(8)])
def test_camera_info_without_distortion_keeps_images(D):
    calibration = calibration_from_camera_info(848, 480, "plumb_bob", D, K)
    assert calibration.keeps_images
    assert calibration.camera.parameters.tolist() == [425.3, 424.9, 427.6, 236.4]


@pytest.mark.parametrize(
    ("distortion_model", "D", "model"),
    [
        ("plumb_bob", [-0.28, 0.07, 0.001, -0.001, -0.01], "RadTan"),
        ("plumb_bob", [-0.28, 0.07, 0.001, -0.001], "RadTan"),
        ("rational_polynomial", [0.47, -2.6, 6e-4, -2e-4, 1.56, 0.35, -2.42, 1.48], "RadTan"),
        ("rational_polynomial", [-0.28, 0.07, 0.001, -0.001, -0.01], "RadTan"),
        ("", [-0.28, 0.07, 0.001, -0.001, -0.01], "RadTan"),
        ("equidistant", [-0.013, 0.042, -0.039, 0.007], "EquiDistant"),
        ("equidistant", [0.0, 0.0, 0.0, 0.0], "EquiDistant"),
        ("fisheye", [-0.013, 0.042, -0.039, 0.007], "EquiDistant"),
    ],
)
def test_camera_info_with_distortion_is_cropped(distortion_model, D, model):
    calibration = calibration_from_camera_info(848, 480, distortion_model, D, np.reshape(K, (3, 3)))
    assert (calibration.lens.model, calibration.lens.distortion) == (model, tuple(D))
    assert not calibration.keeps_images
    assert (calibration.camera.width, calibration.camera.height) == (848, 480)


def test_rectified_images_are_those_of_P():
    calibration = calibration_from_camera_info(848, 480, "plumb_bob", [0.1] * 5, K, P, rectified=True)
    assert calibration.keeps_images
    assert calibration.camera.parameters.tolist() == [400.0, 401.0, 420.0, 240.0]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"K": [float("nan")] * 9}, "/camera_info: a number of the camera is not finite; is the camera calibrated?"),
        ({"K": [0.0] * 9}, "/camera_info: the focal lengths fx=0 fy=0 must be positive; is the camera calibrated?"),
        ({"K": [1.0] * 8}, "/camera_info: K has 8 numbers instead of 9"),
        ({"D": [float("nan")] * 5}, "/camera_info: a number of the camera is not finite"),
        ({"D": [0.1] * 3}, "/camera_info: 3 coefficients in D instead of 4, 5 or 8 for plumb_bob"),
        ({"distortion_model": "equidistant", "D": [0.1] * 5}, "5 coefficients in D instead of 4 for equidistant"),
        ({"distortion_model": "equidistant", "D": []}, "0 coefficients in D instead of 4 for equidistant"),
        ({"distortion_model": "", "D": [0.1] * 4}, "4 coefficients in D instead of 5 or 8 for an unnamed distortion"),
        ({"D": [0.1] * 14}, "14 coefficients in D instead of 4, 5 or 8 for plumb_bob"),
        ({"K": [1.0, 0, 425.3, 0, 1.0, 236.4, 0, 0, 1]}, "fx=1 fy=1 cannot be those of an image of 848x480"),
        ({"K": [425.3, 0, 425.3, 0, 42490.0, 236.4, 0, 0, 1]}, "fx=425.3 fy=42490 cannot be those of an image"),
        ({"K": [425.3, 0, 900.0, 0, 424.9, 236.4, 0, 0, 1]}, "the principal point (900, 236.4) is outside the image"),
        (
            {"roi": Window(800, 0, 100, 100)},
            "100x100 at (800, 0) with binning 1x1, is not within the sensor of 848x480",
        ),
        ({"binning": (849, 1)}, "848x480 at (0, 0) with binning 849x1, is not within the sensor of 848x480"),
        (
            {"distortion_model": "spline", "D": [0.1]},
            "/camera_info: distortion model 'spline' is not known, only plumb_",
        ),
        ({"rectified": True}, "/camera_info: P has 0 numbers instead of 12"),
        ({"width": 0}, "/camera_info: the image size 0x480 must be positive"),
    ],
)
def test_camera_infos_of_no_camera(changes, complaint):
    fields = {"width": 848, "height": 480, "distortion_model": "plumb_bob", "D": [], "K": K, **changes}
    with pytest.raises(InputError, match=re.escape(complaint)):
        calibration_from_camera_info(source="/camera_info", **fields)


@pytest.mark.parametrize("count", [12, 14])
def test_further_coefficients_of_opencv_may_be_zero(count):
    D = [0.47, -2.6, 6e-4, -2e-4, 1.56, 0.35, -2.42, 1.48]
    calibration = calibration_from_camera_info(848, 480, "rational_polynomial", D + [0.0] * (count - 8), K)
    assert calibration.lens.distortion == tuple(D)


def whole_sensor():
    """What the whole sensor sees: the distorted picture of a smooth wall."""
    lens = calibration_from_camera_info(848, 480, "plumb_bob", MILD, K).lens
    u, v = np.meshgrid(np.arange(lens.width, dtype=np.float64), np.arange(lens.height, dtype=np.float64))
    x, y = np.moveaxis(cv2.undistortPoints(np.stack([u, v], -1).reshape(-1, 1, 2), lens.matrix, np.array(MILD)), -1, 0)
    return (32768 + 15000 * np.sin(9 * x) * np.cos(7 * y)).reshape(480, 848)


def wall_seen_by(camera):
    x, y = np.meshgrid(
        (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    )
    return (32768 + 15000 * np.sin(9 * x) * np.cos(7 * y)) / 256


@pytest.mark.parametrize("binning", [(0, 0), (1, 1), (2, 2), (4, 2)])
@pytest.mark.parametrize("roi", [Window(), Window(200, 100, 400, 320), Window(520, 280, 320, 160)])
def test_binning_and_region_of_interest(binning, roi):
    """REP 104: the region is cut out of the sensor's image, and then its pixels are averaged."""
    x, y = (max(factor, 1) for factor in binning)
    part = whole_sensor()
    if roi.width:
        part = part[roi.y_offset : roi.y_offset + roi.height, roi.x_offset : roi.x_offset + roi.width]
    raw = part.reshape(part.shape[0] // y, y, part.shape[1] // x, x).mean(axis=(1, 3)).astype(np.uint16)
    size = raw.shape[::-1]
    calibration = calibration_from_camera_info(
        848, 480, "plumb_bob", MILD, K, binning=binning, roi=roi, image_size=size
    )
    preprocess = ImagePreprocessor(calibration)
    image = preprocess(raw)
    assert image.shape == raw.shape
    np.testing.assert_allclose(image, wall_seen_by(preprocess.camera), atol=0.6)


def test_images_of_the_whole_size_are_those_of_K_whatever_is_said_of_binning():
    plain = calibration_from_camera_info(848, 480, "plumb_bob", BARREL, K)
    for changes in ({"binning": (2, 2)}, {"roi": Window(100, 50, 400, 300)}, {"roi": Window(100, 50, 848, 480)}):
        assert calibration_from_camera_info(848, 480, "plumb_bob", BARREL, K, image_size=(848, 480), **changes) == plain


def test_binning_and_region_hold_for_rectified_images_too():
    calibration = calibration_from_camera_info(
        848, 480, "plumb_bob", BARREL, K, P, rectified=True, binning=(2, 2), roi=Window(400, 200, 400, 200)
    )
    assert calibration.keeps_images
    assert calibration.camera.parameters.tolist() == [200.0, 200.5, 9.75, 19.75]
    assert (calibration.camera.width, calibration.camera.height) == (200, 100)


def test_fields_of_a_message():
    roi = SimpleNamespace(x_offset=1, y_offset=2, width=3, height=4, do_rectify=True)
    message = SimpleNamespace(
        **{"width": 848, "height": 480, "distortion_model": "plumb_bob", "D": np.array(BARREL), "K": K, "P": P},
        **{"binning_x": 2, "binning_y": 1, "roi": roi, "header": object()},
    )
    fields = camera_info_fields(message)
    assert fields == {
        **{"width": 848, "height": 480, "distortion_model": "plumb_bob", "D": tuple(BARREL), "K": tuple(K)},
        **{"P": tuple(P), "binning": (2, 1), "roi": (1, 2, 3, 4)},
    }


@pytest.mark.parametrize(
    ("topic", "is_rectified"),
    [
        ("/camera/up/image_rect", True),
        ("/camera/infra1/image_rect_raw", True),
        ("/camera/rectified/image/compressed", True),
        ("/image_rect_color", True),
        ("/camera/up/image_raw", False),
        ("/direct/corrected", False),
    ],
)
def test_a_topic_whose_name_says_rectified_is_doubted_when_it_is_undistorted(topic, is_rectified):
    doubt = distorted_though_rectified(topic, BARREL)
    assert (doubt is not None) == is_rectified
    if doubt is not None:
        assert topic in doubt
        assert "--rectified" in doubt
        assert "rectified:=true" in doubt
    assert distorted_though_rectified(topic, [0.0] * 5) is None
    assert distorted_though_rectified(topic, []) is None
