# SPDX-License-Identifier: BSD-3-Clause
"""What stands and moves on the floor of a hall: a laser scanner sees it, and the robot cannot drive through it."""

from dataclasses import dataclass
from typing import List, NamedTuple, Sequence, Tuple

import numpy as np

LEG_SPREAD_M = 0.22  # between a person's legs


@dataclass(frozen=True)
class Mover:
    """Someone or something that goes back and forth between two places.

    Attributes:
        start, end: x, y in metres.
        speed_m_s: how fast.
        radius_m: of a round vehicle, or of each leg of a person.
        stride_m: how far a person's legs swing to the front and the back; 0 for a vehicle.
    """

    start: Tuple[float, float]
    end: Tuple[float, float]
    speed_m_s: float
    radius_m: float
    stride_m: float = 0.0

    def centers(self, time_s: np.ndarray) -> np.ndarray:
        """Centres of its circles, (N, 1 or 2, 2) of (N,) times."""
        start, way = np.array(self.start), np.subtract(self.end, self.start)
        length = float(np.hypot(*way))
        along = way / length
        driven = self.speed_m_s * time_s
        distance = length - np.abs(driven % (2 * length) - length)
        middle = start + distance[:, None] * along
        if self.stride_m == 0.0:
            return middle[:, None]
        swing = self.stride_m * np.sin(np.pi * driven / (2 * self.stride_m))
        leg = swing[:, None] * along + LEG_SPREAD_M / 2 * np.array([-along[1], along[0]])
        return np.stack([middle + leg, middle - leg], axis=1)


def person(start: Tuple[float, float], end: Tuple[float, float], speed_m_s: float = 1.2) -> Mover:
    """A person who walks; a scanner near the floor sees two legs."""
    return Mover(start, end, speed_m_s, radius_m=0.07, stride_m=0.3)


def vehicle(start: Tuple[float, float], end: Tuple[float, float], speed_m_s: float = 0.8) -> Mover:
    """A round vehicle."""
    return Mover(start, end, speed_m_s, radius_m=0.4)


WALL_M = 0.8  # that traffic keeps from the walls
KEPT_M = 0.75  # that it keeps from the middle of the robot, which is 0.35 m wide to each side
SHORTEST_WAY_M = 3.0
SHARE_OF_PEOPLE = 0.6
MOST_TRIES = 10_000


def draw_traffic(
    rng: np.random.Generator, size_m: Tuple[float, float], count: int, time_s: np.ndarray, robot: np.ndarray
) -> Tuple[Mover, ...]:
    """People and vehicles that go through a hall on straight ways drawn at random, but never into the robot.

    Args:
        rng: for the ways.
        size_m: of the hall, around the origin.
        count: how many; fewer where the robot leaves no room.
        time_s: (N,) times.
        robot: (N, 2) where the robot then is.
    """
    half = np.array(size_m) / 2 - WALL_M
    movers: List[Mover] = []
    for _ in range(MOST_TRIES):
        if len(movers) == count:
            break
        start, end = rng.uniform(-half, half), rng.uniform(-half, half)
        is_person = rng.random() < SHARE_OF_PEOPLE
        speed = float(rng.uniform(0.7, 1.6) if is_person else rng.uniform(0.4, 1.2))
        if np.hypot(*(end - start)) < SHORTEST_WAY_M:
            continue
        mover = (person if is_person else vehicle)((start[0], start[1]), (end[0], end[1]), speed)
        away_m = np.linalg.norm(mover.centers(time_s) - robot[:, None], axis=-1) - mover.radius_m
        if away_m.min() > KEPT_M:
            movers.append(mover)
    return tuple(movers)


class FloorMap(NamedTuple):
    """A map of what stands: (rows, columns) bool with row 0 at the smallest y, its corner x, y, and the cells' size."""

    occupied: np.ndarray
    corner: Tuple[float, float]
    cell_m: float


@dataclass(frozen=True)
class Obstacles:
    """Everything on the floor.

    Attributes:
        floor_plan: (n, 2, 2) segments in x, y: walls, pillars and what else stands.
        movers: what moves.
    """

    floor_plan: np.ndarray
    movers: Sequence[Mover] = ()

    def ranges_m(self, origins: np.ndarray, rays: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """Distance to the first obstacle along each ray, inf where there is none, (N,).

        Args:
            origins: (N, 2) where each ray begins.
            rays: (N, 2) unit vectors.
            time_s: (N,) when each is cast.
        """
        along = self.floor_plan[:, 1] - self.floor_plan[:, 0]
        toward = self.floor_plan[:, 0] - origins[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            # origin + r ray = start + q along, solved by cross products
            across = rays[:, None, 0] * along[None, :, 1] - rays[:, None, 1] * along[None, :, 0]
            r = (toward[..., 0] * along[:, 1] - toward[..., 1] * along[:, 0]) / across
            q = (toward[..., 0] * rays[:, None, 1] - toward[..., 1] * rays[:, None, 0]) / across
            ranges = np.where((r > 0) & (q >= 0) & (q <= 1), r, np.inf).min(axis=1)
        for mover in self.movers:
            offset = mover.centers(time_s) - origins[:, None]
            ahead = (offset * rays[:, None]).sum(axis=-1)
            discriminant = ahead**2 - (offset**2).sum(axis=-1) + mover.radius_m**2
            near = ahead - np.sqrt(np.maximum(discriminant, 0.0))
            ranges = np.minimum(ranges, np.where((discriminant > 0) & (near > 0), near, np.inf).min(axis=1))
        return ranges

    def floor_map(self, cell_m: float = 0.05) -> FloorMap:
        """The outlines of what stands."""
        corner, far = (edge(self.floor_plan.reshape(-1, 2), axis=0) for edge in (np.min, np.max))
        corner = corner - cell_m
        columns, rows = np.ceil((far - corner) / cell_m).astype(int) + 1
        occupied = np.zeros((rows, columns), dtype=bool)
        for start, end in self.floor_plan:
            count = int(np.hypot(*(end - start)) / cell_m * 2) + 2
            x, y = ((start + np.linspace(0.0, 1.0, count)[:, None] * (end - start) - corner) / cell_m).astype(int).T
            occupied[y, x] = True
        return FloorMap(occupied, (float(corner[0]), float(corner[1])), cell_m)

    def clearance_m(self, points: np.ndarray, time_s: np.ndarray) -> np.ndarray:
        """Distance from points (N, 2) to the nearest obstacle at each time (N,), 0 within a moving one, (N,)."""
        along = self.floor_plan[:, 1] - self.floor_plan[:, 0]
        toward = points[:, None] - self.floor_plan[:, 0]
        share = np.clip((toward * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
        nearest = np.linalg.norm(toward - share[..., None] * along, axis=-1).min(axis=1)
        for mover in self.movers:
            away = np.linalg.norm(mover.centers(time_s) - points[:, None], axis=-1).min(axis=1) - mover.radius_m
            nearest = np.minimum(nearest, np.maximum(away, 0.0))
        return nearest
