# SPDX-License-Identifier: BSD-3-Clause
import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.camera_info import calibration_from_camera_info
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.io.output_camera import crop_camera, full_camera
from ceiling_dso_ros.io.undistortion import Undistorter, undistortion_maps

K = np.array([[425.3, 0, 427.6], [0, 424.9, 236.4], [0, 0, 1]])
RADTAN = (-0.283, 0.074, 1.2e-3, -0.9e-3, -0.011)
EQUIDISTANT = (-0.0134, 0.0421, -0.0387, 0.0066)
LENSES = {
    "RadTan": LensCamera("RadTan", 425.3, 424.9, 427.6, 236.4, RADTAN, 848, 480),
    "EquiDistant": LensCamera("EquiDistant", 425.3, 424.9, 427.6, 236.4, EQUIDISTANT, 848, 480),
    "FOV": LensCamera("FOV", 425.3, 424.9, 427.6, 236.4, (0.9,), 848, 480),
}


def test_radtan_maps_are_those_of_opencv():
    calibration = calibration_from_camera_info(848, 480, "plumb_bob", RADTAN, K)
    expected = cv2.initUndistortRectifyMap(
        K, np.array(RADTAN), np.eye(3), calibration.camera.matrix, (848, 480), cv2.CV_32FC1
    )
    np.testing.assert_allclose(undistortion_maps(calibration), expected, atol=1e-3)


def test_equidistant_maps_are_those_of_opencv():
    calibration = calibration_from_camera_info(848, 480, "equidistant", EQUIDISTANT, K)
    expected = cv2.fisheye.initUndistortRectifyMap(
        K, np.array(EQUIDISTANT), np.eye(3), calibration.camera.matrix, (848, 480), cv2.CV_32FC1
    )
    np.testing.assert_allclose(undistortion_maps(calibration), expected, atol=1e-3)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_every_pixel_shows_what_its_ray_hits_in_the_raw_image(lens):
    u, v = np.meshgrid(np.arange(lens.width, dtype=np.float32), np.arange(lens.height, dtype=np.float32))
    camera = crop_camera(lens, 640, 480)
    undistorter = Undistorter(CameraCalibration(lens, camera))

    X, Y = np.meshgrid((np.arange(640) - camera.cx) / camera.fx, (np.arange(480) - camera.cy) / camera.fy)
    expected_u, expected_v = lens.pixels(X, Y)
    step = 1 / 32  # OpenCV interpolates in steps
    np.testing.assert_allclose(undistorter.undistort(u), expected_u, atol=step)
    np.testing.assert_allclose(undistorter.undistort(v), expected_v, atol=step)


def test_crop_of_a_white_image_is_white_and_full_repeats_the_border():
    white = np.full((480, 848), 255, np.uint8)
    for lens in LENSES.values():
        for choose in (crop_camera, full_camera):
            image = Undistorter(CameraCalibration(lens, choose(lens, 640, 480))).undistort(white)
            assert image.shape == (480, 640)
            assert (image == 255).all()


def test_a_pinhole_is_passed_through():
    undistorter = Undistorter(calibration_from_camera_info(848, 480, "", [], K))
    image = np.random.default_rng(1).uniform(0, 255, (480, 848)).astype(np.float32)
    assert undistorter.undistort(image) is image
    grey = (image + 0.5).astype(np.uint8)
    converted = undistorter.undistort(grey)
    assert converted.dtype == np.float32
    np.testing.assert_array_equal(converted, grey)
