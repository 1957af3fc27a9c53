# SPDX-License-Identifier: BSD-3-Clause
"""Times of a calibration drive at which the wheels did not roll as the camera saw the robot move."""

from dataclasses import dataclass
from typing import List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.scatter import median_scatter
from ceiling_dso_ros.fusion.calibration_data import ImagePair

GATE = 5.0  # standard deviations, as SlipConfig.gate has it
LEAST_M = 0.003  # within a pair of images: play of gears and uneven floors make less
LENGTHS = (1, 2, 4, 8, 16)  # pairs; the longest take 6 s
WRONG_SHARE = 0.1  # of the way; noise is about a hundredth
NAMED_SHARE = 0.5  # of the largest excess: what is smaller may be noise
LASTING_SHARE = 0.5  # of an excess that is left with the neighbours: nothing for an error of a pose, all for a slip


@dataclass(frozen=True)
class WheelSlip:
    """A time that a calibration leaves out.

    Attributes:
        start_ns, end_ns: stamps of the images around it, nanoseconds.
        left_m, right_m: how much further each wheel turned than it moved the robot, metres; negative if it turned less.
        sideways_m: how much further to the left the robot moved by the wheels than by the camera.
    """

    start_ns: int
    end_ns: int
    left_m: float
    right_m: float
    sideways_m: float

    @property
    def what(self) -> str:
        """In words, with the wheel if it was one."""
        largest_m = max(abs(self.left_m), abs(self.right_m), abs(self.sideways_m))
        wheels = {"left": self.left_m, "right": self.right_m}
        named = [
            f"the {name} wheel turned {abs(excess_m):.3f} m too {'far' if excess_m > 0.0 else 'little'}"
            for name, excess_m in wheels.items()
            if abs(excess_m) > NAMED_SHARE * largest_m
        ]
        if abs(self.sideways_m) > NAMED_SHARE * largest_m:
            side = "right" if self.sideways_m > 0.0 else "left"
            named.append(f"the camera saw the robot slide {abs(self.sideways_m):.3f} m to the {side}")
        return ", ".join(named)


def follows(pairs: Sequence[ImagePair]) -> np.ndarray:
    """Whether each pair but the first begins with the image that ends the one before; (n - 1,) bool."""
    return np.array([one.end_ns == next_one.start_ns for one, next_one in zip(pairs, pairs[1:])], bool)


def slipping(excess_m: np.ndarray, used: np.ndarray, way_m: np.ndarray, follow: np.ndarray) -> np.ndarray:
    """The pairs of images between which the wheels slipped: at once, or little by little over several pairs.

    What an error of one image's pose adds to a pair, it takes from the next one. So what the neighbours take back is no
    slip, unless it is more than noise ever is: wheels may also slip forward and back.

    Args:
        excess_m: (n, 3) as `Solution` has it.
        used: (n,) bool, pairs that were taken for good before, of which the scatter is that of the noise.
        way_m: (n,) that the wheels turned, with which noise grows.
        follow: (n - 1,) bool as `follows` gives it.

    Returns:
        (n,) bool.
    """
    scatter_m = median_scatter(excess_m[used], axis=0)
    growth = np.maximum(way_m / np.median(way_m[used]), 1.0)
    slips = np.zeros(len(used), bool)
    for length in LENGTHS:
        starts = _stretches(~beside(slips, follow), follow, length)
        if len(starts) == 0:
            break
        members = starts[:, None] + np.arange(length)
        limit_m = GATE * scatter_m * np.sqrt(growth[members].sum(axis=1))[:, None]
        sums_m = excess_m[members].sum(axis=1)
        beyond = np.abs(sums_m) > np.maximum(limit_m, LEAST_M * np.sqrt(length))
        with_neighbours_m = sums_m + _of_neighbours(excess_m, follow, starts, length)
        lasting = sums_m * with_neighbours_m > LASTING_SHARE * np.square(sums_m)
        large = contradicting(sums_m, way_m[members].sum(axis=1))
        slips[members[(beyond & (lasting | large[:, None])).any(axis=1)]] = True
    return slips


def contradicting(excess_m: np.ndarray, way_m: np.ndarray) -> np.ndarray:
    """The pairs in which a wheel disagrees by more than noise ever does, (n,) bool; arguments as of `slipping`."""
    return np.abs(excess_m).max(axis=1) > np.maximum(WRONG_SHARE * way_m, LEAST_M)


def beside(slips: np.ndarray, follow: np.ndarray) -> np.ndarray:
    """Those pairs and their neighbours, in which a slip may begin or end; (n,) bool of (n,) bool."""
    both = slips.copy()
    both[1:] |= slips[:-1] & follow
    both[:-1] |= slips[1:] & follow
    return both


def _stretches(free: np.ndarray, follow: np.ndarray, length: int) -> np.ndarray:
    """Where that many free pairs begin that follow each other."""
    count = max(len(free) - length + 1, 0)
    good = np.ones(count, bool)
    for offset in range(length):
        good &= free[offset : offset + count]
        if offset:
            good &= follow[offset - 1 : offset - 1 + count]
    return np.flatnonzero(good)


def _of_neighbours(excess_m: np.ndarray, follow: np.ndarray, starts: np.ndarray, length: int) -> np.ndarray:
    """Sum of the pairs directly before and after each stretch, (k, 3); zero where there are none."""
    around_m = np.vstack([np.zeros(3), excess_m, np.zeros(3)])  # pair i is in row i + 1
    joined = np.concatenate([[False], follow, [False]])  # pair i with the one before it
    before_m = around_m[starts] * joined[starts, None]
    return before_m + around_m[starts + length + 1] * joined[starts + length, None]


def described(pairs: Sequence[ImagePair], slips: np.ndarray, excess_m: np.ndarray) -> Tuple[WheelSlip, ...]:
    """The slips, those of consecutive pairs joined."""
    found: List[WheelSlip] = []
    for pair, excess in ((pair, excess) for pair, excess, slips_now in zip(pairs, excess_m, slips) if slips_now):
        last = found[-1] if found and found[-1].end_ns == pair.start_ns else None
        if last is None:
            found.append(WheelSlip(pair.start_ns, pair.end_ns, *map(float, excess)))
        else:
            total = np.add([last.left_m, last.right_m, last.sideways_m], excess)
            found[-1] = WheelSlip(last.start_ns, pair.end_ns, *map(float, total))
    return tuple(found)
