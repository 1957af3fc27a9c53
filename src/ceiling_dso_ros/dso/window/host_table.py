# SPDX-License-Identifier: BSD-3-Clause
"""What the tables of candidates and of active points have in common."""

from typing import Generic, Protocol, TypeVar

import numpy as np


class ArraysWithHosts(Protocol):
    """A struct of arrays of equal capacity."""

    @property
    def host(self) -> np.ndarray:
        """(capacity,) int64 window slot of each entry's host keyframe."""


Arrays = TypeVar("Arrays", bound=ArraysWithHosts)


class HostTable(Generic[Arrays]):
    """Entries of all keyframes in the window, sorted by host slot.

    Attributes:
        arrays: the entries, and room for more behind them.
        count: how many entries there are.
    """

    def __init__(self, arrays: Arrays) -> None:
        """Begin without entries."""
        self.arrays = arrays
        self.count = 0

    @property
    def capacity(self) -> int:
        """How many entries fit."""
        return self.arrays.host.size

    def host_ranges(self, hosts: int) -> np.ndarray:
        """(hosts + 1,) first index of each host slot's entries, and the end."""
        return np.searchsorted(self.arrays.host[: self.count], np.arange(hosts + 1))
