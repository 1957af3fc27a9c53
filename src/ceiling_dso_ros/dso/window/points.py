# SPDX-License-Identifier: BSD-3-Clause
"""Active points: pixels of keyframes with an inverse depth that the bundle adjustment refines, and their residuals."""

from typing import NamedTuple, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays
from ceiling_dso_ros.dso.images.pattern import PATTERN_SIZE
from ceiling_dso_ros.dso.window.host_table import HostTable

# State of a residual, one per (target keyframe, point).
NONE = 0  # never there, or removed
INLIER = 1
OUTLIER = 2  # too large an error in the last linearisation
OUT_OF_BOUNDS = 3  # left the target's image

RELATIVE_PARAMETERS = 8  # of a host-target pair: motion (translation, rotation), gain, offset


@struct_of_arrays
class PointArrays(NamedTuple):
    """Active points as a struct of arrays of equal capacity, float32 unless said otherwise.

    Attributes:
        u, v: pixel in the host keyframe.
        kind: 1, 2 or 4, the size of the selection cell.
        grey, weight: (8, capacity) grey values and gradient weights of the pattern in the host.
        idepth: inverse depth in the host, 1 / VO unit.
        idepth_hessian, idepth_gradient: H_dd and b_d of the last linearisation.
        idepth_intrinsics: (4, capacity) H_cd of the last linearisation.
        host: int64 window slot of the host keyframe; points are sorted by it.
        good_residuals: int64, how many residuals ended as inliers so far.
    """

    u: np.ndarray
    v: np.ndarray
    kind: np.ndarray
    grey: np.ndarray
    weight: np.ndarray
    idepth: np.ndarray
    idepth_hessian: np.ndarray
    idepth_gradient: np.ndarray
    idepth_intrinsics: np.ndarray
    host: np.ndarray
    good_residuals: np.ndarray


@struct_of_arrays
class ResidualArrays(NamedTuple):
    """Residuals in dense slots (target, point).

    Attributes:
        live: (targets, capacity) uint8, 1 where the residual takes part in the optimisation.
        state: (targets, capacity) uint8, see the constants of this module; kept after a residual is removed.
        energy: (targets, capacity) float32 energy of the last linearisation.
        idepth_relative: (targets, 8, capacity) float32, H of the inverse depth against the pair's relative parameters.
    """

    live: np.ndarray
    state: np.ndarray
    energy: np.ndarray
    idepth_relative: np.ndarray


def point_arrays(capacity: int) -> PointArrays:
    """Zeroed arrays."""
    rows = {"grey": PATTERN_SIZE, "weight": PATTERN_SIZE, "idepth_intrinsics": 4}
    types = {"host": np.int64, "good_residuals": np.int64}
    shape = {name: (rows[name], capacity) if name in rows else (capacity,) for name in PointArrays._fields}
    return PointArrays(*(np.zeros(shape[name], types.get(name, np.float32)) for name in PointArrays._fields))


def residual_arrays(targets: int, capacity: int) -> ResidualArrays:
    """Zeroed arrays."""
    return ResidualArrays(
        live=np.zeros((targets, capacity), np.uint8),
        state=np.zeros((targets, capacity), np.uint8),
        energy=np.zeros((targets, capacity), np.float32),
        idepth_relative=np.zeros((targets, RELATIVE_PARAMETERS, capacity), np.float32),
    )


class PointTable(HostTable[PointArrays]):
    """The active points of all keyframes in the window, sorted by host slot, with their residuals."""

    def __init__(self, targets: int, capacity: int) -> None:
        super().__init__(point_arrays(capacity))
        self.residuals = residual_arrays(targets, capacity)

    def clear(self) -> None:
        """Drop all points, and the energies that residuals keep until they are inside an image."""
        self.count = 0
        self.residuals.energy[:] = 0

    def append(
        self, u: np.ndarray, v: np.ndarray, kind: np.ndarray, grey: np.ndarray, weight: np.ndarray, idepth: np.ndarray,
        host: np.ndarray, live: np.ndarray,
    ) -> None:  # fmt: skip
        """Add points; arguments as in PointArrays, live (targets, n) says which residuals start. Sorts by host.

        Points beyond the capacity are left out.
        """
        room = min(u.size, self.capacity - self.count)
        new = slice(self.count, self.count + room)
        for array, values in zip(
            (self.arrays.u, self.arrays.v, self.arrays.kind, self.arrays.idepth, self.arrays.host),
            (u, v, kind, idepth, host),
        ):
            array[new] = values[:room]
        self.arrays.grey[:, new], self.arrays.weight[:, new] = grey[:, :room], weight[:, :room]
        self.arrays.idepth_hessian[new], self.arrays.good_residuals[new] = 0, 0
        self.residuals.live[:, new] = live[:, :room]
        self.residuals.state[:, new] = np.where(live[:, :room], INLIER, NONE)
        self.count += room
        self._reorder(np.argsort(self.arrays.host[: self.count], kind="stable"))

    def add_target(self, target: int) -> None:
        """Give every point a residual into keyframe slot `target`, except points hosted there."""
        elsewhere = self.arrays.host[: self.count] != target
        self.residuals.live[target, : self.count] = elsewhere
        self.residuals.state[target, : self.count] = np.where(elsewhere, INLIER, NONE)

    def keep(self, mask: np.ndarray) -> None:
        """Drop the points whose mask, (count,) bool, is False."""
        self._reorder(np.flatnonzero(mask))

    def remove_keyframe(self, slot: int) -> None:
        """Drop a keyframe's points and the residuals into it; higher slots move down by one."""
        self.keep(self.arrays.host[: self.count] != slot)
        host = self.arrays.host[: self.count]
        host[host > slot] -= 1
        for array in (self.residuals.live, self.residuals.state, self.residuals.energy):
            array[slot:-1] = array[slot + 1 :]
        self.residuals.live[-1], self.residuals.state[-1] = 0, NONE

    def copy_from(self, other: "PointTable", mask: np.ndarray) -> None:
        """Become a copy of those points of another table of the same size whose mask, (count,) bool, is True."""
        self._take(other, np.flatnonzero(mask))

    def _reorder(self, indices: np.ndarray) -> None:
        self._take(self, indices)

    def _take(self, source: "PointTable", indices: np.ndarray) -> None:
        for array, values in zip(self._lasting(), source._lasting()):
            array[..., : indices.size] = values[..., indices]
        self.count = indices.size

    def _lasting(self) -> Tuple[np.ndarray, ...]:
        """The arrays that are kept between linearisations; each linearisation overwrites the others."""
        points, residuals = self.arrays, self.residuals
        return (
            points.u, points.v, points.kind, points.grey, points.weight, points.idepth, points.idepth_hessian,
            points.host, points.good_residuals, residuals.live, residuals.state, residuals.energy,
        )  # fmt: skip
