"""From a raw image to what the odometry works on."""

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.undistortion import Undistorter


class ImagePreprocessor:
    """Corrects raw images photometrically, then undistorts them."""

    def __init__(
        self, calibration: CameraCalibration, photometric: PhotometricCalibration = PhotometricCalibration.linear()
    ) -> None:
        self._size = (calibration.lens.width, calibration.lens.height)
        self._photometric = photometric
        self._undistorter = Undistorter(calibration)
        self.camera: PinholeCamera = calibration.camera

    def __call__(self, raw: np.ndarray) -> np.ndarray:
        """Process a raw image, (H, W) uint8 or uint16.

        Returns:
            The image of `camera`, (height, width) float32, a new array.

        Raises:
            FrameError: the image is not of the size of the calibration, or of another type.
        """
        if raw.ndim != 2 or raw.dtype not in (np.uint8, np.uint16):
            raise FrameError(f"an image must be (height, width) uint8 or uint16, not {raw.shape} {raw.dtype}")
        height, width = raw.shape
        if (width, height) != self._size:
            raise FrameError(
                f"the image is {width}x{height}, but the calibration is for {self._size[0]}x{self._size[1]}"
            )
        return self._undistorter.undistort(self._photometric.correct(raw))
