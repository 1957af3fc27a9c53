# SPDX-License-Identifier: BSD-3-Clause
"""Undistortion of images."""

from typing import Optional, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.projection import Intrinsics, normalized
from ceiling_dso_ros.io.camera_models import CameraCalibration


def undistortion_maps(calibration: CameraCalibration) -> Tuple[np.ndarray, np.ndarray]:
    """Position of each output pixel in the raw image.

    Returns:
        u and v, (height, width) float32 each, of the output's size.
    """
    camera = calibration.camera
    x, y = normalized(Intrinsics(*camera.parameters), np.arange(camera.width), np.arange(camera.height))
    u, v = calibration.lens.pixels(*np.meshgrid(x, y))
    return u.astype(np.float32), v.astype(np.float32)


class Undistorter:
    """Resamples raw images to the pinhole of a calibration, bilinearly."""

    def __init__(self, calibration: CameraCalibration) -> None:
        self._maps: Optional[Tuple[np.ndarray, np.ndarray]] = None
        if not calibration.keeps_images:
            self._maps = undistortion_maps(calibration)

    def undistort(self, image: np.ndarray) -> np.ndarray:
        """Undistort a raw image (H, W) float32 or uint8 to (height, width) float32 of the output camera.

        Where an output shows more than the raw image (`full`), the border pixels are repeated outwards: a black area
            would
        have an edge that moves with the camera. An image that needs no undistortion is returned itself if it is
        float32.
        """
        image = image.astype(np.float32, copy=False)
        if self._maps is None:
            return image
        return cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
