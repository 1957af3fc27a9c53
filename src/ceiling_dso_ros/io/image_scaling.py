# SPDX-License-Identifier: BSD-3-Clause
"""Scales images down, for slow computers, and crops them to a size that can be tracked."""

import re
from typing import Tuple

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.io.errors import InputError


def parse_image_size(text: str, source: str) -> Tuple[int, int]:
    """Width and height from `WIDTHxHEIGHT`, both positive.

    Raises:
        InputError: it is something else; source names the option or parameter.
    """
    match = re.fullmatch(r"0*([1-9]\d*)x0*([1-9]\d*)", text)
    if match is None:
        raise InputError(f"{source} {text}: expected WIDTHxHEIGHT as in 848x480")
    return int(match[1]), int(match[2])


class ImageScaler:
    """Scales images down by area averaging, so that there is no aliasing.

    Attributes:
        camera: camera of the scaled images.
    """

    def __init__(self, camera: PinholeCamera, size: Tuple[int, int]) -> None:
        """Prepare for the camera of the original images and the (width, height) of the scaled ones.

        Raises:
            InputError: the size is larger than the images, or smaller than a camera may be.
        """
        width, height = size
        if width > camera.width or height > camera.height:
            raise InputError(f"the size {width}x{height} is larger than the images, {camera.width}x{camera.height}")
        self._size = size
        try:
            self.camera = scaled_camera(camera, size)
        except ValueError as error:
            raise InputError(str(error)) from error

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Scale an image of the camera that went in, (H, W) float32, to (height, width) float32, a new array."""
        return cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)


class ImageCropper:
    """Cuts the middle out of images.

    Attributes:
        camera: camera of the cropped images.
    """

    def __init__(self, camera: PinholeCamera, size: Tuple[int, int]) -> None:
        """Prepare for the camera of the original images and the (width, height) of the cropped ones, not larger."""
        width, height = size
        left, top = (camera.width - width) // 2, (camera.height - height) // 2
        self._rows, self._columns = slice(top, top + height), slice(left, left + width)
        self.camera = PinholeCamera(camera.fx, camera.fy, camera.cx - left, camera.cy - top, width, height)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Crop an image of the camera that went in, (H, W) float32, to (height, width) float32, a new array."""
        return np.ascontiguousarray(image[self._rows, self._columns])


def scaled_camera(camera: PinholeCamera, size: Tuple[int, int]) -> PinholeCamera:
    """The camera whose images of (width, height) show the same view.

    Raises:
        ValueError: the size is too small.
    """
    width, height = size
    x, y = width / camera.width, height / camera.height
    # The image's edges stay where they are, half a pixel beyond the centres of the outermost pixels.
    cx, cy = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    return PinholeCamera(camera.fx * x, camera.fy * y, cx, cy, width, height)
