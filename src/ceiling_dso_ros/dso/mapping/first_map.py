# SPDX-License-Identifier: BSD-3-Clause
"""The first map of a segment, as the initialiser returns it."""

from dataclasses import dataclass

import numpy as np

from ceiling_dso_ros.dso.images.selection import SelectedPixels


@dataclass(frozen=True)
class FirstMap:
    """Depth of the first frame and motion to the newest one.

    Attributes:
        T_frame_first: (4, 4) float64 motion from the first frame to the newest, in units of the mean depth.
        pixels: pixels of the first frame.
        idepth: (n,) float32 their inverse depths, of mean 1.
        log_gain, offset: brightness from the first frame to the newest.
    """

    T_frame_first: np.ndarray
    pixels: SelectedPixels
    idepth: np.ndarray
    log_gain: float
    offset: float
