# SPDX-License-Identifier: BSD-3-Clause
"""From a raw image to the image that the odometry uses."""

from typing import Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.grey_range import GreyRange
from ceiling_dso_ros.io.image_scaling import ImageCropper, ImageScaler
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.undistortion import Undistorter


class ImagePreprocessor:
    """Corrects raw images photometrically, undistorts them, and scales or crops them where a size is given.

    Attributes:
        camera: of the images that come out.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        photometric: PhotometricCalibration = PhotometricCalibration.linear(),
        size: Optional[Tuple[int, int]] = None,
        crop: Optional[Tuple[int, int]] = None,
        grey_range: Optional[GreyRange] = None,
    ) -> None:
        """Take the calibrations, and how the images are to be.

        Args:
            calibration: of the raw images.
            photometric: of the raw images.
            size: (width, height) to scale to, None for the calibration's own.
            crop: (width, height) of the middle that is left of the scaled image, None for all of it.
            grey_range: of images with more than 8 bits; found from them if None.

        Raises:
            InputError: the images cannot be scaled to that size.
        """
        self._calibration = calibration
        self._photometric = photometric
        self._grey_range = GreyRange() if grey_range is None else grey_range
        self._undistorter = Undistorter(calibration)
        self.camera: PinholeCamera = calibration.camera
        self._scaler: Optional[ImageScaler] = None
        if size is not None and size != (self.camera.width, self.camera.height):
            self._scaler = ImageScaler(self.camera, size)
            self.camera = self._scaler.camera
        self._cropper = None if crop is None else ImageCropper(self.camera, crop)
        if self._cropper is not None:
            self.camera = self._cropper.camera

    def __call__(self, raw: np.ndarray) -> np.ndarray:
        """Process a raw image, (H, W) uint8, uint16 or float32.

        Returns:
            The image of `camera`, (height, width) float32, a new array.

        Raises:
            FrameError: the image is not of the size of the calibration, or of another type.
        """
        self.check(raw)
        image = self._undistorter.undistort(self._photometric.correct(raw, self._grey_range.units(raw)))
        image = image if self._scaler is None else self._scaler(image)
        return image if self._cropper is None else self._cropper(image)

    def check(self, raw: np.ndarray) -> None:
        """Refuse what is not a raw image of this camera.

        Raises:
            FrameError: the image is not of the size of the calibration, or of another type.
        """
        if raw.ndim != 2 or raw.dtype not in (np.uint8, np.uint16, np.float32):
            raise FrameError(f"an image must be (height, width) uint8, uint16 or float32, not {raw.shape} {raw.dtype}")
        self._calibration.require_size_of(raw)
