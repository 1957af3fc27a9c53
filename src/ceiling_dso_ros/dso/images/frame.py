# SPDX-License-Identifier: BSD-3-Clause
"""An image and its estimates while the odometry processes it."""

from dataclasses import dataclass
from typing import Callable, Optional

import numpy as np

RightImage = Callable[[], Optional[np.ndarray]]  # gives the image of the second camera, None where it has none


@dataclass(frozen=True)
class Frame:
    """An image with the estimates made so far.

    Attributes:
        stamp_ns: nanoseconds.
        exposure: on the scale of `ExposureScale`.
        image_slot: its pyramid in the pool.
        T_camera_world: (4, 4) float64 tracked pose.
        affine: (2,) tracked brightness (a, b).
        normal: (3,) normal of the plane in which the camera moves, in its own frame; None where it may move otherwise.
        right: gives the image of the second camera, (height, width) float32; None without one.
        smooth: the image was smoothed against its noise.
    """

    stamp_ns: int
    exposure: float
    image_slot: int
    T_camera_world: np.ndarray
    affine: np.ndarray
    normal: Optional[np.ndarray] = None
    right: Optional[RightImage] = None
    smooth: bool = False
