"""What a segment begins with."""

from dataclasses import dataclass

import numpy as np

from ceiling_dso_ros.dso.images.selection import SelectedPixels


@dataclass(frozen=True)
class FirstMap:
    """What the initialiser hands over.

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
