# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot drives: paths, the speed along them within the drive's limits, and the pose at any time."""

from dataclasses import dataclass
from typing import Callable, Protocol, Sequence, Tuple, Union

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

STEP_S = 0.005  # between the nodes of the splines
STEP_M = 0.005  # between the points of a path
SMOOTHING_S = 0.08  # standard deviation of the low-pass on acceleration: a drive's jerk is bounded too
REST_S = 0.5  # standing still before and after each leg, longer than the low-pass reaches


@dataclass(frozen=True)
class DriveLimits:
    """Limits of the drive; the defaults are those of an industrial platform."""

    speed_m_s: float = 1.0
    acceleration_m_s2: float = 0.6
    yaw_rate_rad_s: float = 0.9
    yaw_acceleration_rad_s2: float = 1.5


@dataclass(frozen=True)
class Path:
    """A curve that the robot follows, driving forward.

    Attributes:
        distance_m: (N,) along the curve, from 0, evenly spaced.
        poses: (N, 3) x, y, yaw (continuous, not wrapped).
        backward: the robot drives backward, from the start to the end.
    """

    distance_m: np.ndarray
    poses: np.ndarray
    backward: bool = False


@dataclass(frozen=True)
class Turn:
    """A turn on the spot by so many radians, counter-clockwise if positive."""

    angle_rad: float


@dataclass(frozen=True)
class Wait:
    """Standing still."""

    duration_s: float


Leg = Union[Path, Turn, Wait]


def straight(length_m: float, backward: bool = False) -> Path:
    """A straight line ahead."""
    distance = np.linspace(0.0, length_m, max(2, int(length_m / STEP_M) + 1))
    along = -distance if backward else distance
    return Path(distance, np.stack([along, 0 * along, 0 * along], axis=1), backward)


def rounded_square(side_m: float, corner_m: float, laps: int) -> Path:
    """A square whose corners have linearly rising and falling curvature (clothoids); it closes exactly.

    Args:
        side_m: length of the straight parts.
        corner_m: length of a corner along the path.
        laps: how often it is driven.
    """
    pieces = [side_m / 2, corner_m / 2, corner_m / 2, side_m / 2]
    knots = np.concatenate([[0.0], np.cumsum(pieces * (4 * laps))])
    peak = np.pi / corner_m  # the triangle's area is a quarter turn
    count = round(knots[-1] / STEP_M)
    distance = np.linspace(0.0, knots[-1], count + 1)
    middle = (distance[1:] + distance[:-1]) / 2
    curvature = np.interp(middle, knots, np.concatenate([np.tile([0.0, 0.0, peak, 0.0], 4 * laps), [0.0]]))
    yaw = np.concatenate([[0.0], np.cumsum(curvature)]) * distance[1]
    yaw *= 2 * np.pi * laps / yaw[-1]
    heading = (yaw[1:] + yaw[:-1]) / 2
    xy = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) * distance[1]
    return Path(distance, np.column_stack([np.vstack([[0.0, 0.0], xy]), yaw]))


def closed_curve(point: Callable[[np.ndarray], Tuple[np.ndarray, np.ndarray]], laps: int) -> Path:
    """A smooth closed curve, moved so that it starts at the origin along x.

    Args:
        point: x and y in metres of a parameter that goes from 0 to 2 pi once around.
        laps: how often it is driven.
    """
    parameter = np.linspace(0.0, 2 * np.pi, 20001)
    xy = np.stack(point(parameter), axis=1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    spline = CubicSpline(length, np.vstack([xy[:-1], xy[:1]]), bc_type="periodic")
    distance = np.linspace(0.0, laps * length[-1], round(laps * length[-1] / STEP_M) + 1)
    around = distance % length[-1]
    tangent = spline(around, 1)
    along_x, along_y = np.ascontiguousarray(tangent.T)  # or the last bit depends on its place in memory
    yaw = np.unwrap(np.arctan2(along_y, along_x))
    start = np.array([*xy[0], yaw[0]])
    return Path(distance, _seen_from(start, np.column_stack([spline(around), yaw])))


def _seen_from(start: np.ndarray, poses: np.ndarray) -> np.ndarray:
    c, s = np.cos(start[2]), np.sin(start[2])
    x, y = poses[:, 0] - start[0], poses[:, 1] - start[1]
    return np.stack([c * x + s * y, c * y - s * x, poses[:, 2] - start[2]], axis=1)


def _placed(start: np.ndarray, poses: np.ndarray) -> np.ndarray:
    c, s = np.cos(start[2]), np.sin(start[2])
    x, y = poses[:, 0], poses[:, 1]
    return np.stack([start[0] + c * x - s * y, start[1] + s * x + c * y, start[2] + poses[:, 2]], axis=1)


class BaseMotion(Protocol):
    """How base_link moves over a flat floor."""

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        """x, y, yaw (not wrapped): (N, 3) of (N,) times."""

    def rates(self, time_s: np.ndarray) -> np.ndarray:
        """Speed (m/s) and yaw rate (rad/s): (N, 2)."""


class Motion:
    """A planned motion of base_link over a flat floor, from time 0 to `duration_s`.

    Attributes:
        duration_s: its end; before 0 and after the end the robot stands.
    """

    def __init__(self, start: np.ndarray, legs: Sequence[Leg], limits: DriveLimits) -> None:
        """Time the legs one after the other, from the pose `start` (x, y, yaw)."""
        poses, travel = [np.asarray(start, dtype=np.float64)[None]], [np.zeros(1)]
        for leg in legs:
            leg_poses, leg_travel = _timed(leg, limits)
            poses.append(_placed(poses[-1][-1], leg_poses))
            travel.append(travel[-1][-1] + leg_travel)
        table = np.column_stack([np.concatenate(poses), np.concatenate(travel)])
        self.duration_s = (len(table) - 1) * STEP_S
        self._spline = CubicSpline(np.arange(len(table)) * STEP_S, table, bc_type="clamped")

    def poses(self, time_s: np.ndarray) -> np.ndarray:
        """x, y, yaw (not wrapped): (N, 3) of (N,) times."""
        return self._spline(self._clamped(time_s))[:, :3]

    def travel_m(self, time_s: np.ndarray) -> np.ndarray:
        """Signed distance driven along base_link's x axis since the start, (N,)."""
        return self._spline(self._clamped(time_s))[:, 3]

    def rates(self, time_s: np.ndarray) -> np.ndarray:
        """Speed (m/s) and yaw rate (rad/s): (N, 2)."""
        return self._spline(self._clamped(time_s), 1)[:, [3, 2]]

    def _clamped(self, time_s: np.ndarray) -> np.ndarray:
        return np.clip(np.atleast_1d(time_s), 0.0, self.duration_s)


def _timed(leg: Leg, limits: DriveLimits) -> Tuple[np.ndarray, np.ndarray]:
    """Poses (N, 3) seen from the leg's start and distance driven (N,), every STEP_S, the start itself left out."""
    if isinstance(leg, Wait):
        count = max(1, round(leg.duration_s / STEP_S))
        return np.zeros((count, 3)), np.zeros(count)
    if isinstance(leg, Turn):
        angle = np.linspace(0.0, abs(leg.angle_rad), 2000)
        progress = _smoothed(_progress(angle, np.full(2000, limits.yaw_rate_rad_s), limits.yaw_acceleration_rad_s2))
        yaw = np.copysign(progress, leg.angle_rad)
        return np.stack([0 * yaw, 0 * yaw, yaw], axis=1), np.zeros(len(yaw))
    speed = _speed_limit(leg, limits)
    progress = _smoothed(_progress(leg.distance_m, speed, limits.acceleration_m_s2))
    poses = CubicSpline(leg.distance_m, leg.poses)(progress)
    return poses, -progress if leg.backward else progress


def _speed_limit(path: Path, limits: DriveLimits) -> np.ndarray:
    """What speed, yaw rate k v and yaw acceleration k' v^2 + k a allow at each point of a path of curvature k."""
    step = path.distance_m[1]
    curvature = np.abs(np.gradient(path.poses[:, 2], step))
    change = maximum_filter1d(np.abs(np.gradient(np.gradient(path.poses[:, 2], step), step)), 9)  # kinks count
    # a margin of a tenth, because the low-pass shifts the speed a little along the path
    left_over = np.maximum(0.9 * limits.yaw_acceleration_rad_s2 - curvature * limits.acceleration_m_s2, 0.2)
    return np.minimum.reduce(
        [
            np.full(len(curvature), limits.speed_m_s),
            limits.yaw_rate_rad_s / np.maximum(curvature, 1e-9),
            np.sqrt(left_over / np.maximum(change, 1e-9)),
        ]
    )


def _progress(distance: np.ndarray, speed_limit: np.ndarray, acceleration: float) -> np.ndarray:
    """Distance every STEP_S of the fastest drive from rest to rest within the limits."""
    squared = speed_limit**2
    squared[0] = squared[-1] = 0.0
    gain = 2 * acceleration * distance[1]
    for order in (range(1, len(squared)), range(len(squared) - 2, -1, -1)):
        back = -order.step
        for i in order:
            squared[i] = min(squared[i], squared[i + back] + gain)
    speed = np.sqrt(squared)
    time = np.concatenate([[0.0], np.cumsum(2 * distance[1] / (speed[1:] + speed[:-1]))])
    now = np.arange(STEP_S, time[-1] + STEP_S, STEP_S)
    cell = np.clip(np.searchsorted(time, now, side="right") - 1, 0, len(time) - 2)
    since = np.minimum(now, time[-1]) - time[cell]
    slope = (speed[cell + 1] - speed[cell]) / (time[cell + 1] - time[cell])
    return distance[cell] + speed[cell] * since + 0.5 * slope * since**2


def _smoothed(progress: np.ndarray) -> np.ndarray:
    """Low-pass filtered, with rest before and after. Averaging keeps the accelerations within their limits."""
    rest = round(REST_S / STEP_S)
    padded = np.concatenate([np.zeros(rest), progress, np.full(rest, progress[-1])])
    return gaussian_filter1d(padded, SMOOTHING_S / STEP_S, mode="nearest", truncate=REST_S / SMOOTHING_S)


def transforms(poses: np.ndarray, heights: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """T_world_base (N, 4, 4) of x, y, yaw (N, 3), height, and tilt: Rz(yaw) Ry(pitch) Rx(roll)."""
    angles = np.array([poses[:, 2], pitch, roll])  # in rows, or the last bit depends on their place in memory
    (cy, cp, cr), (sy, sp, sr) = np.cos(angles), np.sin(angles)
    T = np.zeros((len(poses), 4, 4))
    T[:, 0, 0], T[:, 0, 1], T[:, 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    T[:, 1, 0], T[:, 1, 1], T[:, 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    T[:, 2, 0], T[:, 2, 1], T[:, 2, 2] = -sp, cp * sr, cp * cr
    T[:, 0, 3], T[:, 1, 3], T[:, 2, 3] = poses[:, 0], poses[:, 1], heights
    T[:, 3, 3] = 1.0
    return T
