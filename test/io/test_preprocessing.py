# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.camera_info import calibration_from_camera_info
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.grey_range import GreyRange
from ceiling_dso_ros.io.image_scaling import scaled_camera
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.io.output_camera import crop_camera
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor

PINHOLE = calibration_from_camera_info(160, 120, "", [], [100.0, 0, 80, 0, 100, 60, 0, 0, 1])


def test_a_linear_pinhole_only_converts():
    raw = np.random.default_rng(1).integers(0, 256, (120, 160), dtype=np.uint8)
    preprocess = ImagePreprocessor(PINHOLE)
    image = preprocess(raw)
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, raw)
    assert not np.shares_memory(image, preprocess(raw)), "the odometry may keep an image"


def test_the_vignette_belongs_to_the_raw_image():
    """A white wall seen through vignetting and distortion is white again."""
    x, y = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 120))
    vignette = (1 - 0.3 * (x * x + y * y)).astype(np.float32)
    raw = np.round(200 * vignette * 256).astype(np.uint16)
    lens = LensCamera("RadTan", 100, 100, 80, 60, (-0.2, 0.0, 0.0, 0.0), 160, 120)
    calibration = CameraCalibration(lens, crop_camera(lens, 128, 96))
    preprocess = ImagePreprocessor(calibration, PhotometricCalibration(np.arange(256.0), vignette))

    image = preprocess(raw)

    assert image.shape == (preprocess.camera.height, preprocess.camera.width) == (96, 128)
    np.testing.assert_allclose(image, 200, atol=0.01)


@pytest.mark.parametrize(
    ("raw", "complaint"),
    [
        (np.zeros((60, 80), np.uint8), "the image is 80x60, but the calibration is for 160x120"),
        (np.zeros((120, 160), np.int16), r"must be \(height, width\) uint8, uint16 or float32, not \(120, 160\) int16"),
        (np.zeros((120, 160, 3), np.uint8), r"must be \(height, width\) uint8, uint16 or float32, not \(120, 160, 3\)"),
    ],
)
def test_other_images_are_refused(raw, complaint):
    with pytest.raises(FrameError, match=complaint):
        ImagePreprocessor(PINHOLE)(raw)


def test_a_size_scales_what_has_been_undistorted():
    lens = LensCamera("RadTan", 100, 100, 80, 60, (-0.2, 0.0, 0.0, 0.0), 160, 120)
    calibration = CameraCalibration(lens, crop_camera(lens, 160, 120))
    raw = np.random.default_rng(1).integers(0, 256, (120, 160), dtype=np.uint8)
    preprocess = ImagePreprocessor(calibration, size=(80, 60 + 4))
    image = preprocess(raw)
    assert image.shape == (preprocess.camera.height, preprocess.camera.width) == (64, 80)
    whole = ImagePreprocessor(calibration)(raw)
    assert image.mean() == pytest.approx(whole.mean(), rel=1e-3)
    assert preprocess.camera == scaled_camera(calibration.camera, (80, 64))


def test_the_calibrations_own_size_leaves_the_image_as_it_is():
    raw = np.random.default_rng(1).integers(0, 256, (120, 160), dtype=np.uint8)
    np.testing.assert_array_equal(ImagePreprocessor(PINHOLE, size=(160, 120))(raw), raw)


def test_a_size_that_is_too_large_is_refused():
    with pytest.raises(InputError, match="320x240 is larger than the images, 160x120"):
        ImagePreprocessor(PINHOLE, size=(320, 240))


def test_the_middle_is_left_of_cropped_images():
    lens = LensCamera("RadTan", 100, 100, 80, 60, (-0.2, 0.0, 0.0, 0.0), 160, 120)
    calibration = CameraCalibration(lens, crop_camera(lens, 159, 119))
    raw = np.random.default_rng(1).integers(0, 256, (120, 160), dtype=np.uint8)
    whole, cropped = ImagePreprocessor(calibration), ImagePreprocessor(calibration, crop=(152, 112))
    np.testing.assert_array_equal(cropped(raw), whole(raw)[3:115, 3:155])
    camera = cropped.camera
    assert (camera.width, camera.height, camera.fx) == (152, 112, whole.camera.fx)
    assert (camera.cx, camera.cy) == (whole.camera.cx - 3, whole.camera.cy - 3)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("given", [False, True])
def test_images_of_any_depth_become_the_same(bits, given):
    eight = np.random.default_rng(1).integers(0, 256, (120, 160), dtype=np.uint8)
    raw = eight.astype(np.uint16) << (bits - 8)
    preprocess = ImagePreprocessor(PINHOLE, grey_range=GreyRange(bits if given else 0))
    np.testing.assert_array_equal(preprocess(raw), eight)
