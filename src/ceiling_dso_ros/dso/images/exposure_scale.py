# SPDX-License-Identifier: BSD-3-Clause
"""Exposures on one scale, also where some are unknown."""

from typing import Optional


class ExposureScale:
    """Gives every image an exposure that may be compared with those of the others.

    Only ratios of exposures matter, and the brightness (a, b) of each frame absorbs what they leave unexplained. So an
    unknown exposure is that of the last image: no change is assumed that nobody has measured. Where the exposures
    become known late, the first known one is put equal to what was assumed before it.
    """

    def __init__(self) -> None:
        self._exposure = 1.0  # of the last image
        self._unit: Optional[float] = None  # of a millisecond; None until an exposure is known
        self._begun = False

    def of(self, exposure_ms: Optional[float]) -> float:
        """Exposure of the next image; equal to exposure_ms where all are known.

        Args:
            exposure_ms: None or not positive when unknown.
        """
        if exposure_ms is not None and exposure_ms > 0:
            if self._unit is None:
                self._unit = self._exposure / exposure_ms if self._begun else 1.0
            self._exposure = self._unit * exposure_ms
        self._begun = True
        return self._exposure
