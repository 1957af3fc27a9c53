# SPDX-License-Identifier: BSD-3-Clause
"""A drive without an end: there and back again, the images and the wheels' angles in reverse."""

from dataclasses import replace
from typing import Iterator, List, Optional

import numpy as np
from support.faults.drive import Drive, Picture, Sample


class Shuttle(Drive):
    """A drive from rest to rest, backward when it has ended, and so on.

    Args:
        drive: that ends at rest.
    """

    def __init__(self, drive: Drive) -> None:
        self.lens, self.T_base_camera = drive.lens, drive.T_base_camera
        self._drive = drive
        self._there: List[Sample] = list(drive)
        self._length_s = self._there[-1].time_s + 1.0 / 50.0

    def __iter__(self) -> Iterator[Sample]:
        last: Optional[np.ndarray] = None
        for leg in range(10**9):
            for sample in self._there if leg % 2 == 0 else reversed(self._there):
                if isinstance(sample, Picture):
                    if sample.pixels is last:  # a camera never sees the very same twice
                        continue
                    last = sample.pixels
                yield replace(sample, time_s=self._on_the_way(leg, sample.time_s))

    def pose(self, time_s: float) -> np.ndarray:
        """See Drive."""
        leg, along_s = divmod(time_s, self._length_s)
        return self._drive.pose(along_s if leg % 2 == 0 else self._length_s - along_s)

    def _on_the_way(self, leg: int, along_s: float) -> float:
        return leg * self._length_s + (along_s if leg % 2 == 0 else self._length_s - along_s)
