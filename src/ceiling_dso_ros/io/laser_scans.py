# SPDX-License-Identifier: BSD-3-Clause
"""The scans of a 2D LiDAR, whatever they were recorded with."""

from dataclasses import dataclass
from typing import Callable, Counter, List, NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.limits import MOST_RAYS
from ceiling_dso_ros.io.stamps import longest_increasing

SMALLEST_M = 0.02  # of a range without limits of its own: nearer returns are those of the scanner's window


class ScanGeometry(NamedTuple):
    """How the rays of one scan lie.

    Attributes:
        angle_min_rad: of the first ray in the laser's frame.
        angle_increment_rad: from ray to ray, negative where the mirror turns clockwise.
        time_increment_s: from ray to ray, 0 where it is unknown.
    """

    angle_min_rad: float
    angle_increment_rad: float
    time_increment_s: float


@dataclass(frozen=True)
class LaserScans:
    """All scans of one LiDAR.

    Attributes:
        stamps_ns: (N,) int64 nanoseconds of the first rays, increasing.
        ranges_m: (N, R) float32, NaN where a ray has no valid return or the scan has fewer rays.
        geometry: (N, 3) float64, each row a ScanGeometry.
        T_base_laser: (4, 4) pose of the laser in base_link.
        source: names them in messages.
    """

    stamps_ns: np.ndarray
    ranges_m: np.ndarray
    geometry: np.ndarray
    T_base_laser: np.ndarray
    source: str = "the scans"

    def __len__(self) -> int:
        """How many there are."""
        return len(self.stamps_ns)

    @property
    def valid_share(self) -> float:
        """Share of the rays that have a valid return."""
        return float(np.isfinite(self.ranges_m).mean())

    @property
    def sweep_s(self) -> np.ndarray:
        """(N,) seconds from the first ray of a scan to its last, 0 where unknown."""
        return self.geometry[:, 2] * (self.ranges_m.shape[1] - 1)

    def select(self, index: np.ndarray) -> "LaserScans":
        """Some of them, by increasing index (M,) or by a mask (N,)."""
        return LaserScans(
            self.stamps_ns[index], self.ranges_m[index], self.geometry[index], self.T_base_laser, self.source
        )


class ScanCollector:
    """Collects scans one by one; those that cannot be used are counted and told at the end."""

    def __init__(self, source: str, warn: Callable[[str], None]) -> None:
        self._source, self._warn = source, warn
        self._stamps_ns: List[int] = []
        self._ranges_m: List[np.ndarray] = []
        self._geometry: List[ScanGeometry] = []
        self._count = 0
        self.unused = Counter[str]()  # reason -> scans

    def add(
        self,
        stamp_ns: int,
        ranges_m: np.ndarray,
        geometry: ScanGeometry,
        limits_m: Optional[np.ndarray] = None,
    ) -> None:
        """Add a scan.

        Args:
            stamp_ns: of the first ray, nanoseconds.
            ranges_m: (R,) as recorded: also 0, NaN, inf or beyond the limits.
            geometry: of its rays.
            limits_m: smallest and largest valid range; limits that contradict each other do not count.
        """
        self._count += 1
        if not np.isfinite(geometry).all() or geometry.angle_increment_rad == 0.0 or geometry.time_increment_s < 0.0:
            self.unused["angle_min, angle_increment or time_increment is not possible"] += 1
        elif not 2 <= len(ranges_m) <= MOST_RAYS:
            self.unused[f"the number of rays is not between 2 and {MOST_RAYS}"] += 1
        elif abs(geometry.angle_increment_rad) * (len(ranges_m) - 1) > 4.0 * np.pi:
            self.unused["the rays cover more than two turns"] += 1
        else:
            self._stamps_ns.append(stamp_ns)
            self._ranges_m.append(_valid(np.asarray(ranges_m, np.float32), limits_m))
            self._geometry.append(geometry)

    def scans(self, T_base_laser: np.ndarray) -> LaserScans:
        """All of them in the order of time.

        Raises:
            InputError: none can be used.
        """
        kept = longest_increasing(self._stamps_ns)
        if len(kept) < len(self._stamps_ns):
            self.unused["the stamp is out of order, or that of another scan"] += len(self._stamps_ns) - len(kept)
        for reason, count in self.unused.items():
            self._warn(f"{self._source}: {count} of {self._count} scans are not used: {reason}")
        if not kept:
            why = f"all {self._count} are unusable: {', '.join(self.unused)}" if self._count else "there are none"
            raise InputError(f"{self._source}: has no scans that can be used; {why}")
        ranges = np.full((len(kept), max(len(self._ranges_m[index]) for index in kept)), np.nan, np.float32)
        for row, index in zip(ranges, kept):
            row[: len(self._ranges_m[index])] = self._ranges_m[index]
        scans = LaserScans(
            np.array([self._stamps_ns[index] for index in kept], np.int64),
            ranges,
            np.array([self._geometry[index] for index in kept], np.float64),
            T_base_laser,
            self._source,
        )
        if scans.valid_share == 0.0:
            raise InputError(f"{self._source}: no ray of any of its {len(scans)} scans has a valid range")
        return scans


def _valid(ranges_m: np.ndarray, limits_m: Optional[np.ndarray]) -> np.ndarray:
    """The ranges with NaN where there is no valid return."""
    smallest, largest = SMALLEST_M, np.inf
    if limits_m is not None and 0.0 <= limits_m[0] < limits_m[1]:
        smallest, largest = max(SMALLEST_M, float(limits_m[0])), float(limits_m[1])
    with np.errstate(invalid="ignore"):
        is_valid = np.isfinite(ranges_m) & (ranges_m >= smallest) & (ranges_m <= largest)
    return np.where(is_valid, ranges_m, np.float32(np.nan))
