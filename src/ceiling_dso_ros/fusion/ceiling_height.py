# SPDX-License-Identifier: BSD-3-Clause
"""The height of the ceiling above the camera: a first guess of the scale of a new map, by which it is doubted, too."""

import math
from typing import Optional

HEIGHT_SIGMA = 0.07  # of its logarithm from a map to the next one under the same roof: girders, lamps and ducts
GATE = 3.0  # sigmas
LONGEST_DOUBT_M = 10.0  # of driving: then it is another hall


class CeilingHeight:
    """Compares the scale of a segment with that of the segments before: a ceiling does not change its height by much.

    Wheels that slip just after the camera was blind, while the scale of its new map is found, give a wrong one.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing is known of the ceiling."""
        self._log_height: Optional[float] = None  # metres, of the segments whose scale was known
        self.begin_segment()

    def begin_segment(self) -> None:
        """The next keyframe is the first of a segment."""
        self._newest, self._way_m = math.nan, 0.0  # of this segment

    def see(self, log_scale: float, depth: float, way_m: float) -> None:
        """Take in a keyframe.

        Args:
            log_scale: logarithm of metres per unit by the wheels.
            depth: median depth of the map that it sees, units; nan where it is not known.
            way_m: of the wheels since the keyframe before.
        """
        self._newest = log_scale + math.log(depth) if depth > 0.0 else math.nan
        self._way_m += way_m

    def believe(self) -> None:
        """The scale is known."""
        if math.isfinite(self._newest):
            self._log_height = self._newest

    def log_scale(self, depth: float) -> float:
        """Logarithm of metres per unit of a new map, nan where nothing is known.

        Args:
            depth: median depth of the map, units; nan where it is not known.
        """
        return math.nan if self._log_height is None or not depth > 0.0 else self._log_height - math.log(depth)

    @property
    def agrees(self) -> bool:
        """Whether the scale of the segment is possible under the same ceiling, or has been the same for long."""
        if self._log_height is None or not math.isfinite(self._newest) or self._way_m > LONGEST_DOUBT_M:
            return True
        return abs(self._newest - self._log_height) < GATE * HEIGHT_SIGMA
