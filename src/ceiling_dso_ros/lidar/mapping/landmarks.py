# SPDX-License-Identifier: BSD-3-Clause
"""Walls as short straight lines, found from the points of all keyframes, and scans localised between them."""

from dataclasses import dataclass
from typing import NamedTuple, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.lidar.mapping.landmark_kernels import (
    add_to_lines,
    choose_windows,
    count_crossings,
    fit_lines,
    place_points,
    variances_within,
)
from ceiling_dso_ros.lidar.mapping.pose_kernels import GATE, localise, sum_groups
from ceiling_dso_ros.lidar.scans.poses import compose

LEAST_POINTS = 6  # of a landmark
LEAST_ALONG_M = 0.02  # standard deviation along it: the direction of a shorter one is that of its noise
ROUGH = 3.0  # times the usual standard deviation across: what is rougher is not a wall
LARGEST_SIGMA_M = 0.1
ROBUST_PASSES = 2
SHRINKAGE = 20.0  # points with the usual variance that are added to those of each landmark
MOST_CELLS = 2**25  # of the map: 850 m x 850 m with the usual size
MARGIN_CELLS = 4
FOLLOWED_RAYS = 3  # one of so many
CLEAR_M, CLEAR_SIGMAS = 0.15, 5.0  # behind a surface, a ray has gone through it
LOOKED_THROUGH = 0.1  # share of the rays that go through what moves, or through glass
FEWEST_KEYFRAMES = 3
LOCALISATION_GATES = np.array([8.0, 5.0, GATE, GATE])


@dataclass(frozen=True)
class KeyframePoints:
    """The points of all keyframes.

    Attributes:
        points: (P, 2) seen from themselves.
        first: (K + 1,) where those of each begin.
        laser: (2,) its place in base_link.
    """

    points: np.ndarray
    first: np.ndarray
    laser: np.ndarray

    @staticmethod
    def of(parts: Sequence[np.ndarray], laser: np.ndarray) -> "KeyframePoints":
        """Of (n, 2) points for each keyframe."""
        first = np.append(0, np.cumsum([len(part) for part in parts])).astype(np.int64)
        return KeyframePoints(np.concatenate(parts) if parts else np.zeros((0, 2)), first, laser)

    def placed(self, poses: np.ndarray) -> np.ndarray:
        """(P, 2) points in the map, where the keyframes have poses (K, 3)."""
        placed = np.empty_like(self.points)
        place_points(self.points, self.first, poses, placed)
        return placed

    def eyes(self, poses: np.ndarray) -> np.ndarray:
        """(K, 2) places of the laser in the map."""
        return compose(poses, np.tile([*self.laser, 0.0], (len(poses), 1)))[:, :2].copy()


class Localised(NamedTuple):
    """A scan in the map: (3,) pose, (3, 3) information of its points, how many fit."""

    pose: np.ndarray
    information: np.ndarray
    fitting: int


@dataclass(frozen=True)
class LandmarkMap:
    """Lines by cells of the plane.

    Attributes:
        origin: (2,) x, y of the corner of cell 0.
        cell_m: size of the cells.
        shape: rows and columns.
        landmarks: (cells,) int32, that of each cell.
        lines: (cells, 6) as `fit_lines` gives them.
        variances: (cells,) across the lines, 0 where there is none.
        sigma_m: the usual standard deviation across, that of the scanner's noise.
    """

    origin: np.ndarray
    cell_m: float
    shape: Tuple[int, int]
    landmarks: np.ndarray
    lines: np.ndarray
    variances: np.ndarray
    sigma_m: float

    @property
    def count(self) -> int:
        """Number of landmarks."""
        return int(np.count_nonzero(self.variances))

    def sum_groups(self, keyframes: KeyframePoints, poses: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """See the kernel; sorted by landmark."""
        members, sums = sum_groups(
            keyframes.placed(poses), keyframes.first, poses, self.landmarks, self.origin, self.cell_m, *self.shape,
            self.lines, self.variances,
        )  # fmt: skip
        order = np.argsort(members[:, 1], kind="stable")
        return members[order], sums[order]

    def localise(self, points: np.ndarray, start: np.ndarray, prior: np.ndarray) -> Localised:
        """The pose of a scan of (n, 2) points, near a first guess (3,) with the information (3, 3)."""
        return Localised(
            *localise(
                points, self.landmarks, self.origin, self.cell_m, *self.shape, self.lines, self.variances, start,
                prior, LOCALISATION_GATES,
            )
        )  # fmt: skip


def find_landmarks(keyframes: KeyframePoints, poses: np.ndarray, cell_m: float, smallest_sigma_m: float) -> LandmarkMap:
    """Find the lines.

    Args:
        keyframes: points of all of them.
        poses: (K, 3) of the keyframes.
        cell_m: size of the cells, half of that of a landmark.
        smallest_sigma_m: no surface is known better.

    Raises:
        InputError: the points are too far from each other.
    """
    placed = keyframes.placed(poses)
    reached = np.concatenate([placed, poses[:, :2]])
    low, high = reached.min(axis=0), reached.max(axis=0)
    # on multiples of the cells: the same cells however far the points reach
    origin = cell_m * (np.floor(low / cell_m) - MARGIN_CELLS)
    columns, rows = (int(each) for each in np.ceil((high - origin) / cell_m) + MARGIN_CELLS)
    if rows * columns > MOST_CELLS:
        raise InputError(f"the map would have {rows} x {columns} cells of {cell_m} m: the scans do not fit together")
    landmarks = choose_windows(placed, origin, cell_m, rows, columns)
    lines = np.zeros((rows * columns, 6))
    spread_m, sigma_m = np.inf, smallest_sigma_m
    grid = (landmarks, origin, cell_m, rows, columns)
    for _ in range(1 + ROBUST_PASSES):
        sums = np.zeros((rows * columns, 6))
        add_to_lines(placed, *grid, lines, spread_m, sums)
        fit_lines(sums, origin, cell_m, columns, lines)
        is_used = sums[:, 0] >= LEAST_POINTS
        is_line = is_used & (lines[:, 5] > LEAST_ALONG_M**2) & (lines[:, 5] > 4.0 * lines[:, 4])
        if is_line.any():
            sigma_m = max(float(np.sqrt(np.median(lines[is_line, 4]))), smallest_sigma_m)
        spread_m = 4.0 * sigma_m
    found = np.zeros((rows * columns, 2))
    variances_within(placed, *grid, lines, GATE * sigma_m, found)
    near, squares = found.T
    with np.errstate(invalid="ignore", divide="ignore"):
        own = squares / np.maximum(near - 2.0, 1.0)  # two variables of the line
        usual = float(np.median(own[is_line & (near >= LEAST_POINTS)])) if is_line.any() else sigma_m**2
        variances = (near * own + SHRINKAGE * usual) / (near + SHRINKAGE)
    is_line &= (near >= LEAST_POINTS) & (variances < min(LARGEST_SIGMA_M, ROUGH * sigma_m) ** 2)
    is_line &= _stands(keyframes, poses, placed, grid, lines, sigma_m)
    variances = np.where(is_line, np.maximum(variances, smallest_sigma_m**2), 0.0)
    return LandmarkMap(origin, cell_m, (rows, columns), landmarks, lines, variances, float(np.sqrt(max(usual, 0.0))))


def _stands(
    keyframes: KeyframePoints,
    poses: np.ndarray,
    placed: np.ndarray,
    grid: Tuple[np.ndarray, np.ndarray, float, int, int],
    lines: np.ndarray,
    sigma_m: float,
) -> np.ndarray:
    """(cells,) bool: landmarks that several keyframes have seen, and that none has looked through."""
    found = np.zeros((len(lines), 3), np.int32)
    clear_m = max(CLEAR_M, CLEAR_SIGMAS * sigma_m)
    count_crossings(placed, keyframes.first, keyframes.eyes(poses), FOLLOWED_RAYS, *grid, lines, clear_m, found)
    seen, ends, crossings = found.T
    return (seen >= min(FEWEST_KEYFRAMES, len(poses))) & (crossings <= LOOKED_THROUGH * (ends + crossings))
