# SPDX-License-Identifier: BSD-3-Clause
"""Images of the second camera on their way to the odometry."""

from typing import Callable, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso import StereoRig
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.grey_range import GreyRange
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import SecondCamera

RawRight = Callable[[], np.ndarray]  # gives the raw image, or raises FrameError


class RightImages:
    """Converts raw images of the second camera, where they are needed.

    Attributes:
        rig: the geometry of the two cameras.
    """

    def __init__(
        self, camera: SecondCamera, size: Optional[Tuple[int, int]], crop: Optional[Tuple[int, int]], bits: int = 0
    ) -> None:
        """Take the camera; size, crop and bits are those of the images of the first one.

        Raises:
            InputError: the images cannot be scaled to that size, or the pose of the camera cannot be used.
        """
        grey_range = GreyRange(bits)
        self._preprocess = ImagePreprocessor(camera.calibration, camera.photometric, size, crop, grey_range)
        try:
            self.rig = StereoRig(self._preprocess.camera, camera.T_left_right)
        except ValueError as error:
            raise InputError(str(error)) from error

    def later(self, raw: RawRight) -> Callable[[], Optional[np.ndarray]]:
        """Gives the image, (height, width) float32, when it is asked for; None if it cannot be used."""

        def image() -> Optional[np.ndarray]:
            try:
                return self._preprocess(raw())
            except FrameError:
                return None

        return image
