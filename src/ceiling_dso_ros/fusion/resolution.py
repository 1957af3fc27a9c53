# SPDX-License-Identifier: BSD-3-Clause
"""The resolution of wheel readings that no data sheet tells."""

import math
from typing import Optional, Tuple

import numpy as np


class Resolution:
    """Finds the resolution of readings from how much they change from one to the next.

    While a robot drives, the changes of coarse readings go to and fro by one step, those of fine readings by as little
    as its speed is uneven. A speed that is exactly constant, or changes evenly, as in a simulation, tells nothing.
    """

    SAME = 0.01  # share of the finest: changes that are nearer are equal but for rounding
    LEAST = 10  # turns to and fro, and their share of all changes: fewer are those of a speed that is set in steps
    LEAST_SHARE = 0.05
    SAME_TIME = 1.5  # changes over times with a larger ratio are not compared, since samples are missing

    def __init__(self, finest: float) -> None:
        self._finest = finest
        self._last: Optional[Tuple[np.ndarray, float]] = None
        self._signs: Optional[np.ndarray] = None  # of the last differences
        self._changes = self._turns = 0
        self._smallest = math.inf

    @property
    def step(self) -> float:
        """The resolution in the unit of the readings; the finest that is assumed, where no coarser one is found."""
        if self._turns < max(self.LEAST, self.LEAST_SHARE * self._changes):
            return self._finest
        return max(self._smallest, self._finest)

    def add(self, changes: np.ndarray, duration_s: float) -> None:
        """Add the (n,) changes of readings that are equally coarse, in a time."""
        if self._signs is None:
            self._signs = np.zeros(len(changes))
        same = self.SAME * self._finest
        if self._last is not None and max(duration_s, self._last[1]) < self.SAME_TIME * min(duration_s, self._last[1]):
            differences = changes - self._last[0]
            differ = np.abs(differences) > same
            turned = differ & (differences * self._signs < 0.0)
            self._changes += int(np.count_nonzero(np.abs(changes) > same))
            self._turns += int(np.count_nonzero(turned))
            self._smallest = float(np.min(np.abs(differences[turned]), initial=self._smallest))
            self._signs = np.where(differ, np.sign(differences), self._signs)
        self._last = changes, duration_s
