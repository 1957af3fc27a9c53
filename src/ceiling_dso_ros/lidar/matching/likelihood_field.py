# SPDX-License-Identifier: BSD-3-Clause
"""The likelihood field of a submap: a correlative search finds the pose of a scan in it, Gauss-Newton refines it."""

from typing import NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.matching.field_kernels import add_to_statistics, refresh_distributions, stamp_raster
from ceiling_dso_ros.lidar.matching.free_space_kernels import in_free_space, mark_hits, mark_passes
from ceiling_dso_ros.lidar.matching.matching_kernels import align_points
from ceiling_dso_ros.lidar.matching.search_kernels import NO_PLACE, search_places

LEVELS = 6  # of the pyramid that is searched: 32 cells of the raster at the top
RASTER_SIGMA = 1.2  # cells of the raster
SEARCHED_POINTS = 180
FINEST_ANGLE_RAD = 0.004
DISTANCE_PENALTY, TURN_PENALTY = 0.02, 0.02  # of the score at the border of the search
WIDTHS, ITERATIONS = np.array([4.0, 2.0, 1.0]), 8
FREE_CELL_M = 0.2
UNKNOWN = 150  # of 255: likelihood of a point where nothing is known; of right places, that of all points is higher
MARGIN_M = 2.0  # around the points of the first scan, for those that come into view


class Match(NamedTuple):
    """A scan aligned with a field.

    Attributes:
        pose: (3,) in the frame of the field.
        information: (3, 3) of x, y, yaw in that frame.
        outer: (3, 3) sum of the outer products of the points' gradients.
        fit: share of the points with a small residual.
        seen: share of the points where the field has points.
    """

    pose: np.ndarray
    information: np.ndarray
    outer: np.ndarray
    fit: float
    seen: float


class Place(NamedTuple):
    """The result of a search: a pose (3,) in the frame of the field, and its mean likelihood, 0 to 1."""

    pose: np.ndarray
    score: float


class LikelihoodField:
    """Points of several scans in one frame."""

    def __init__(self, radius_m: float, config: LidarConfig) -> None:
        """An empty field around the origin of its frame; points beyond the radius are left out."""
        self._config = config
        border_m = radius_m + MARGIN_M + 2 ** (LEVELS - 1) * config.raster_m
        cells, pixels = (int(np.ceil(2.0 * border_m / size)) for size in (config.cell_m, config.raster_m))
        self._origin = np.array([-border_m, -border_m])
        self._statistics = np.zeros((cells, cells, 6))
        self._distributions = np.zeros((cells, cells, 6), np.float32)
        self._marks = np.zeros((cells, cells), np.int32)
        self._mark = 0
        self._raster = np.zeros((pixels, pixels), np.uint8)
        self._inner_m = radius_m + MARGIN_M
        free_cells = int(np.ceil(2.0 * border_m / FREE_CELL_M))
        self._hits = np.zeros((free_cells, free_cells), np.uint8)
        self._passes = np.zeros((free_cells, free_cells), np.uint8)
        self._levels: Optional[np.ndarray] = None

    def mark_free(self, points: np.ndarray, eye: np.ndarray) -> None:
        """Nothing stands where rays pass, from the laser's place (2,) to (n, 2) points, in the frame of the field."""
        mark_passes(points, eye, self._passes, self._origin, FREE_CELL_M)

    def is_moving(self, points: np.ndarray) -> np.ndarray:
        """Which of (n, 2) points in the frame of the field are where rays have passed and nothing stands, (n,) bool."""
        return in_free_space(points, self._hits, self._passes, self._origin, FREE_CELL_M)

    def add(self, points: np.ndarray) -> None:
        """Add the (n, 2) points of a scan, in the frame of the field."""
        points = points[np.abs(points).max(axis=1) < self._inner_m]
        touched = add_to_statistics(points, self._statistics, self._origin, self._config.cell_m)
        self._mark += 1
        refresh_distributions(
            self._statistics, touched, self._marks, self._mark, self._config.range_sigma_m, self._distributions
        )
        mark_hits(points, self._hits, self._origin, FREE_CELL_M)
        sigma_m = RASTER_SIGMA * self._config.raster_m
        stamp_raster(points, self._raster, self._origin, self._config.raster_m, sigma_m)
        self._levels = None

    def align(self, points: np.ndarray, start: np.ndarray, known: np.ndarray, information: np.ndarray) -> Match:
        """Align (n, 2) points of a scan by Gauss-Newton.

        Args:
            points: in the frame of the robot.
            start: (3,) first guess of the pose in the frame of the field.
            known: (3,) what is known of it by other means.
            information: (3, 3) of that.
        """
        return Match(
            *align_points(
                points,
                self._distributions,
                self._origin,
                self._config.cell_m,
                start,
                known,
                information,
                WIDTHS,
                ITERATIONS,
            )
        )

    def search(
        self,
        points: np.ndarray,
        centre: np.ndarray,
        reach_m: float,
        reach_rad: float,
        least_score: float,
        without: Optional[np.ndarray] = None,
    ) -> Optional[Place]:
        """The most likely pose of (n, 2) points near a first guess; None where no score is high enough.

        Args:
            points: in the frame of the robot.
            centre: (3,) the first guess.
            reach_m, reach_rad: how far from it the pose may be.
            least_score: what a place must have.
            without: a pose in the neighbourhood of which nothing counts, to see whether there are other places.
        """
        points = _thinned(points, self._config.raster_m)
        if not len(points):
            return None
        raster_m = self._config.raster_m
        step_rad = max(FINEST_ANGLE_RAD, raster_m / max(float(np.percentile(np.hypot(*points.T), 80.0)), raster_m))
        half = int(np.ceil(reach_rad / step_rad))
        angles = centre[2] + step_rad * np.arange(-half, half + 1)
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        x = c * points[:, 0] - s * points[:, 1] + centre[0] - self._origin[0]
        y = s * points[:, 0] + c * points[:, 1] + centre[1] - self._origin[1]
        reach = np.full(2, max(1, int(np.ceil(reach_m / raster_m))))
        found = search_places(
            self._pyramid(),
            np.floor(x / raster_m).astype(np.int32),
            np.floor(y / raster_m).astype(np.int32),
            reach,
            least_score,
            np.array([DISTANCE_PENALTY, TURN_PENALTY]),
            self._excluded(without, centre, half, step_rad),
        )
        index, dx, dy, score = found
        if index == NO_PLACE:
            return None
        return Place(np.array([centre[0] + dx * raster_m, centre[1] + dy * raster_m, angles[index]]), float(score))

    def _excluded(self, without: Optional[np.ndarray], centre: np.ndarray, half: int, step_rad: float) -> np.ndarray:
        if without is None:
            return np.array([NO_PLACE, 0, 0, 0, 0])
        dx, dy = np.round((without[:2] - centre[:2]) / self._config.raster_m)
        turn = np.pi - (np.pi - (without[2] - centre[2])) % (2.0 * np.pi)
        near_rad, near_m = 0.2, 0.6
        return np.array(
            [
                half + round(turn / step_rad),
                dx,
                dy,
                np.ceil(near_rad / step_rad),
                np.ceil(near_m / self._config.raster_m),
            ],
            dtype=np.int64,
        )

    def _pyramid(self) -> np.ndarray:
        if self._levels is None:
            levels = np.zeros((LEVELS, *self._raster.shape), np.uint8)
            levels[0] = self._raster
            if self._passes.any():
                np.maximum(levels[0], np.where(self._is_unknown(), UNKNOWN, 0), out=levels[0], casting="unsafe")
            for level in range(1, LEVELS):
                step = 2 ** (level - 1)
                wide, below = levels[level], levels[level - 1]
                wide[:] = below
                np.maximum(wide[:, :-step], below[:, step:], out=wide[:, :-step])
                rows = wide.copy()
                np.maximum(wide[:-step], rows[step:], out=wide[:-step])
            self._levels = levels
        return self._levels

    def _is_unknown(self) -> np.ndarray:
        """(rows, columns) bool: pixels of the raster where nothing was hit and no ray has passed.

        A scan shows new things where the robot has driven on: they speak neither for a place nor against it.
        """
        unknown = (self._passes == 0) & (self._hits == 0)
        rows, columns = self._raster.shape
        index = (np.arange(max(rows, columns)) * (self._config.raster_m / FREE_CELL_M)).astype(np.int64)
        index = np.minimum(index, len(unknown) - 1)
        return unknown[np.ix_(index[:rows], index[:columns])]


def _thinned(points: np.ndarray, size_m: float) -> np.ndarray:
    """Points of different cells, at most SEARCHED_POINTS of them, evenly chosen."""
    cells = np.floor(points / (2.0 * size_m)).astype(np.int64)
    _, first = np.unique(cells[:, 0] * 2**32 + cells[:, 1], return_index=True)
    first.sort()
    if len(first) > SEARCHED_POINTS:
        first = first[np.linspace(0, len(first) - 1, SEARCHED_POINTS).astype(np.int64)]
    return points[first]
