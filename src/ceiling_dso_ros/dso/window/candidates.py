# SPDX-License-Identifier: BSD-3-Clause
"""Candidate points: pixels of keyframes whose inverse depth is still being narrowed down to an interval."""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.images.interpolation import sample_gradient
from ceiling_dso_ros.dso.images.pattern import GRADIENT_WEIGHT, PATTERN_SIZE, PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.images.selection import SelectedPixels
from ceiling_dso_ros.dso.window.host_table import HostTable
from ceiling_dso_ros.dso.window.trace_outcome import UNTRACED

UNSEARCHED_QUALITY = 1e4  # until a first search; searches give less


@struct_of_arrays
class CandidateArrays(NamedTuple):
    """Candidates as a struct of arrays of equal capacity, float32 unless said otherwise.

    Attributes:
        u, v: pixel in the host keyframe.
        kind: 1, 2 or 4, the size of the selection cell.
        grey, weight: (8, capacity) grey values and gradient weights of the pattern in the host.
        grad_xx, grad_xy, grad_yy: sums of gradient products over the pattern.
        idepth_min, idepth_max: interval of the inverse depth; idepth_max is nan while unbounded.
        quality: second best over best energy of the last search.
        interval: length of the interval in pixels of the last trace.
        host: int64 window slot of the host keyframe; candidates are sorted by it.
        outcome: uint8, result of the last trace, see trace_outcome.
    """

    u: np.ndarray
    v: np.ndarray
    kind: np.ndarray
    grey: np.ndarray
    weight: np.ndarray
    grad_xx: np.ndarray
    grad_xy: np.ndarray
    grad_yy: np.ndarray
    idepth_min: np.ndarray
    idepth_max: np.ndarray
    quality: np.ndarray
    interval: np.ndarray
    host: np.ndarray
    outcome: np.ndarray

    @classmethod
    def of_capacity(cls, capacity: int) -> "CandidateArrays":
        """Zeroed arrays."""
        patterns = ("grey", "weight")
        types = {"host": np.int64, "outcome": np.uint8}
        shape = {name: (PATTERN_SIZE, capacity) if name in patterns else (capacity,) for name in cls._fields}
        return cls(*(np.zeros(shape[name], types.get(name, np.float32)) for name in cls._fields))


@kernel
def initialize_candidates(
    candidates: CandidateArrays, first: int, u: np.ndarray, v: np.ndarray, kind: np.ndarray, host: int,
    image: np.ndarray, width: int, idepth_min: float, idepth_max: float,
) -> None:  # fmt: skip
    """Fill candidates[first : first + u.size] with untraced candidates of an image; idepth_max nan is unbounded."""
    for k in range(u.size):
        i = first + k
        candidates.u[i], candidates.v[i], candidates.kind[i] = u[k], v[k], kind[k]
        candidates.host[i], candidates.outcome[i] = host, UNTRACED
        candidates.idepth_min[i], candidates.idepth_max[i] = idepth_min, idepth_max
        candidates.quality[i], candidates.interval[i] = UNSEARCHED_QUALITY, 0.0
        candidates.grad_xx[i] = candidates.grad_xy[i] = candidates.grad_yy[i] = 0.0
        for p in range(PATTERN_SIZE):
            grey, grad_x, grad_y = sample_gradient(image, width, u[k] + PATTERN_X[p], v[k] + PATTERN_Y[p])
            candidates.grey[p, i] = grey
            candidates.weight[p, i] = np.sqrt(GRADIENT_WEIGHT / (GRADIENT_WEIGHT + grad_x * grad_x + grad_y * grad_y))
            candidates.grad_xx[i] += grad_x * grad_x
            candidates.grad_xy[i] += grad_x * grad_y
            candidates.grad_yy[i] += grad_y * grad_y


class CandidateTable(HostTable[CandidateArrays]):
    """The candidates of all keyframes in the window, sorted by host slot."""

    def __init__(self, capacity: int) -> None:
        super().__init__(CandidateArrays.of_capacity(capacity))

    def add(
        self, pixels: SelectedPixels, host: int, image: np.ndarray, width: int,
        idepth_range: Tuple[float, float] = (0.0, np.nan),
    ) -> None:  # fmt: skip
        """Append untraced candidates of the newest host; candidates beyond the capacity are dropped.

        Args:
            pixels, host, image, width: where they are.
            idepth_range: where their inverse depths are searched first; nan is no bound.
        """
        room = self.capacity - self.count
        u, v, kind = pixels.u[:room], pixels.v[:room], pixels.kind[:room]
        initialize_candidates(self.arrays, self.count, u, v, kind, host, image, width, *idepth_range)
        self.count += u.size

    def keep(self, mask: np.ndarray) -> None:
        """Drop the candidates whose mask, (count,) bool, is False."""
        kept = np.flatnonzero(mask)
        for array in self.arrays:
            array[..., : kept.size] = array[..., kept]
        self.count = kept.size

    def remove_host(self, slot: int) -> None:
        """Drop a host's candidates; higher slots move down by one."""
        self.keep(self.arrays.host[: self.count] != slot)
        host = self.arrays.host[: self.count]
        host[host > slot] -= 1
