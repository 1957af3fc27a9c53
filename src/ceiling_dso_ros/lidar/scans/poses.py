# SPDX-License-Identifier: BSD-3-Clause
"""Many planar poses at once, and a pose at any time between them; conventions as in `fusion.planar`.

A pose is x, y in metres and yaw in radians; arrays have the shape (..., 3).
"""

from dataclasses import dataclass

import numpy as np

from ceiling_dso_ros.dso.durations import seconds


def wrap(angles_rad: np.ndarray) -> np.ndarray:
    """The same angles in (-pi, pi]."""
    return np.pi - (np.pi - angles_rad) % (2.0 * np.pi)


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """T_x_z of a = T_x_y and b = T_y_z."""
    # contiguous, or numpy's last bit depends on where the angles lie in memory
    yaw = np.array(a[..., 2])
    c, s = np.cos(yaw), np.sin(yaw)
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap(a[..., 2] + b[..., 2])], axis=-1)


def inverse(a: np.ndarray) -> np.ndarray:
    """T_y_x of a = T_x_y."""
    yaw = np.array(a[..., 2])
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], -a[..., 2]], axis=-1)


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """T_a_b of T_x_a and T_x_b."""
    return compose(inverse(a), b)


def logmap(poses: np.ndarray) -> np.ndarray:
    """The arcs (forward, left, turn) that lead to the poses."""
    turn = wrap(np.array(poses[..., 2]))
    half = 0.5 * turn
    safe = np.where(np.abs(half) > 1e-9, half, 1.0)
    a = np.where(np.abs(half) > 1e-9, safe / np.tan(safe), 1.0)
    return np.stack(
        [a * poses[..., 0] + half * poses[..., 1], -half * poses[..., 0] + a * poses[..., 1], turn], axis=-1
    )


def expmap(twists: np.ndarray) -> np.ndarray:
    """The poses reached by driving arcs (forward, left, turn)."""
    turn = np.array(twists[..., 2])
    small = np.abs(turn) < 1e-6
    safe = np.where(small, 1.0, turn)
    a = np.where(small, 1.0 - turn**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 * turn, 2.0 * np.sin(0.5 * safe) ** 2 / safe)
    return np.stack(
        [a * twists[..., 0] - b * twists[..., 1], b * twists[..., 0] + a * twists[..., 1], wrap(turn)], axis=-1
    )


def matrices(poses: np.ndarray) -> np.ndarray:
    """T_map_base, (N, 4, 4) of (N, 3) poses: z = 0, turned about z."""
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    yaw = np.ascontiguousarray(poses[:, 2])
    T[:, 0, 0] = T[:, 1, 1] = np.cos(yaw)
    T[:, 1, 0] = np.sin(yaw)
    T[:, 0, 1] = -T[:, 1, 0]
    T[:, :2, 3] = poses[:, :2]
    return T


def transformed(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """(n, 2) points seen from a pose (3,), in the frame of the pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


@dataclass(frozen=True)
class Path:
    """Poses over time.

    Attributes:
        stamps_ns: (N,) int64 nanoseconds, increasing, N at least 1.
        poses: (N, 3).
    """

    stamps_ns: np.ndarray
    poses: np.ndarray

    def at(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Poses on the arcs between those of the path, (M, 3); before it begins and after it ends it stands."""
        if len(self.stamps_ns) == 1:
            return np.repeat(self.poses, len(stamps_ns), axis=0)
        wanted = np.clip(stamps_ns, self.stamps_ns[0], self.stamps_ns[-1])
        index = np.clip(np.searchsorted(self.stamps_ns, wanted, side="right") - 1, 0, len(self.stamps_ns) - 2)
        step_s = seconds(self.stamps_ns[index + 1] - self.stamps_ns[index])
        share = seconds(wanted - self.stamps_ns[index]) / step_s
        arcs = logmap(between(self.poses[index], self.poses[index + 1]))
        return compose(self.poses[index], expmap(share[:, None] * arcs))

    def covers(self, stamps_ns: np.ndarray, gap_ns: int) -> np.ndarray:
        """Whether there is a pose of the path before and after each stamp, not further apart than gap_ns, (M,) bool."""
        after = np.searchsorted(self.stamps_ns, stamps_ns)
        inside = (stamps_ns >= self.stamps_ns[0]) & (stamps_ns <= self.stamps_ns[-1])
        after = np.clip(after, 1, max(len(self.stamps_ns) - 1, 1))
        if len(self.stamps_ns) == 1:
            return inside
        return inside & (self.stamps_ns[after] - self.stamps_ns[after - 1] <= gap_ns)


def carried(path: Path, shape: Path, stamps_ns: np.ndarray) -> np.ndarray:
    """Poses of a path at other stamps, where it moves between its poses as another one does, (M, 3).

    What the other path misses from pose to pose is spread evenly over the time between them: the motion is that of the
    wheels, its ends are those of the scans. Before its first pose and after its last, the path goes on as the other.

    Args:
        path: poses that are reached.
        shape: how it moves between them.
        stamps_ns: (M,) int64.
    """
    here = shape.at(path.stamps_ns)
    last = max(len(path.stamps_ns) - 2, 0)
    index = np.clip(np.searchsorted(path.stamps_ns, stamps_ns, side="right") - 1, 0, last)
    moved = between(here[index], shape.at(stamps_ns))
    poses = compose(path.poses[index], moved)
    if len(path.stamps_ns) == 1:
        return poses
    follow = index + 1
    # what is left to the next pose after the whole step, in the frame of that pose
    arrived = compose(path.poses[index], between(here[index], here[follow]))
    missing = logmap(between(arrived, path.poses[follow]))
    step_s = seconds(path.stamps_ns[follow] - path.stamps_ns[index])
    share = np.clip(seconds(stamps_ns - path.stamps_ns[index]) / step_s, 0.0, None)
    beyond = stamps_ns >= path.stamps_ns[follow]
    share = np.where(beyond, 1.0, share)
    poses = compose(poses, expmap(share[:, None] * missing))
    return np.where(beyond[:, None], compose(path.poses[follow], between(here[follow], shape.at(stamps_ns))), poses)
