# SPDX-License-Identifier: BSD-3-Clause
"""A drive without an end: there and back again, the images and the wheels' angles in reverse."""

from dataclasses import replace
from typing import Iterator, List

import numpy as np
from support.faults.drive import Drive, Picture, Sample


class Shuttle(Drive):
    """A drive from rest to rest, backward when it has ended, and so on.

    Images that are shown again have other noise: only a camera that hangs gives the very same ones.

    Args:
        drive: that ends at rest.
    """

    def __init__(self, drive: Drive) -> None:
        self.lens, self.T_base_camera = drive.lens, drive.T_base_camera
        self._drive = drive
        self._there: List[Sample] = list(drive)
        self._length_s = self._there[-1].time_s + 1.0 / 50.0

    def __iter__(self) -> Iterator[Sample]:
        rng, last = np.random.default_rng(0), None
        for leg in range(10**9):
            for sample in self._there if leg % 2 == 0 else reversed(self._there):
                again = sample
                if isinstance(sample, Picture):
                    if sample.pixels is last:
                        continue
                    last = sample.pixels
                    if leg > 0:
                        again = sample.showing(sample.pixels + rng.integers(-1, 2, sample.pixels.shape, np.int16))
                yield replace(again, time_s=self._on_the_way(leg, sample.time_s))

    def pose(self, time_s: float) -> np.ndarray:
        """See Drive."""
        leg, along_s = divmod(time_s, self._length_s)
        return self._drive.pose(along_s if leg % 2 == 0 else self._length_s - along_s)

    def _on_the_way(self, leg: int, along_s: float) -> float:
        return leg * self._length_s + (along_s if leg % 2 == 0 else self._length_s - along_s)
