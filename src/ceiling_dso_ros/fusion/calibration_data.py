# SPDX-License-Identifier: BSD-3-Clause
"""Data of a calibration: pairs of images, and the wheels' path for an assumed ratio, base and time offset."""

import math
from dataclasses import dataclass
from typing import Dict, Iterable, List, Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.fusion.wheel_motion import WheelStep

PAIR_S = 0.4  # between the images of a pair
LARGEST_OFFSET_S = 0.2


@dataclass(frozen=True)
class CameraPose:
    """Pose of the camera at an image: stamp, segment of the visual odometry, (4, 4) in its world and unit."""

    stamp_ns: int
    segment: int
    T_world_camera: np.ndarray


def camera_poses(statuses: Iterable[OdometryStatus]) -> List[CameraPose]:
    """Poses of all tracked images, re-expressed on their keyframes as last refined."""
    tracked: List[OdometryStatus] = []
    keyframes: Dict[int, np.ndarray] = {}
    for status in statuses:
        keyframes.update((keyframe.keyframe_id, keyframe.T_world_camera) for keyframe in status.keyframes)
        if status.state is TrackingState.TRACKING:
            tracked.append(status)
    return [CameraPose(s.stamp_ns, s.segment, keyframes[s.keyframe_id] @ s.T_keyframe_camera) for s in tracked]


@dataclass(frozen=True)
class ImagePair:
    """Motion of the camera between two images.

    Attributes:
        start_ns, end_ns: their stamps, nanoseconds.
        segment: of the visual odometry.
        rotation, translation: (3, 3) and (3,) of the second camera in the first, VO units.
    """

    start_ns: int
    end_ns: int
    segment: int
    rotation: np.ndarray
    translation: np.ndarray


class WheelPath:
    """The wheels' path as a function of ratio and base.

    Attributes:
        stamps_ns: (n,) int64 of the samples.
    """

    def __init__(self, steps: Sequence[WheelStep], wheel_base_m: float) -> None:
        self.stamps_ns = np.array([steps[0].start_ns, *(step.end_ns for step in steps)], np.int64)
        self._ages_s = seconds(self.stamps_ns - self.stamps_ns[0])
        self._twists = np.array([step.twist for step in steps])
        self._base = wheel_base_m

    def poses(self, ages_s: np.ndarray, ratio: float, base: float) -> np.ndarray:
        """(n, 3) x, y, unwrapped yaw at seconds after the first; logarithms of ratio and base relative to nominal."""
        forward, left, turn = self._twists.T
        half = 0.5 * self._base * turn
        left_wheel, right_wheel = (forward - half) * math.exp(-0.5 * ratio), (forward + half) * math.exp(0.5 * ratio)
        forward, turn = 0.5 * (left_wheel + right_wheel), (right_wheel - left_wheel) / (self._base * math.exp(base))
        yaw = np.concatenate([[0.0], np.cumsum(turn)])
        middle = yaw[:-1] + 0.5 * turn
        dx, dy = np.cos(middle) * forward - np.sin(middle) * left, np.sin(middle) * forward + np.cos(middle) * left
        path = np.column_stack([np.concatenate([[0.0], np.cumsum(dx)]), np.concatenate([[0.0], np.cumsum(dy)]), yaw])
        return np.column_stack([np.interp(ages_s, self._ages_s, column) for column in path.T])

    def motions(self, pairs: Sequence[ImagePair], offset_s: float, ratio: float, base: float) -> np.ndarray:
        """(n, 3) motion between the images of each pair, seen from the first."""
        stamps_ns = np.array([[p.start_ns, p.end_ns] for p in pairs], np.int64)
        start_s, end_s = seconds(stamps_ns - self.stamps_ns[0]).T
        first = self.poses(start_s + offset_s, ratio, base)
        second = self.poses(end_s + offset_s, ratio, base)
        yaw = np.ascontiguousarray(first[:, 2])  # or the last bit depends on its place in memory
        c, s = np.cos(yaw), np.sin(yaw)
        dx, dy, turn = (second - first).T
        return np.column_stack([c * dx + s * dy, c * dy - s * dx, turn])


def image_pairs(poses: Sequence[CameraPose], wheels: WheelPath) -> List[ImagePair]:
    """Consecutive images PAIR_S apart, within the wheels' record, between which the robot moved."""
    margin_ns = nanoseconds(LARGEST_OFFSET_S)
    first_ns, last_ns = wheels.stamps_ns[0] + margin_ns, wheels.stamps_ns[-1] - margin_ns
    pairs: List[ImagePair] = []
    before: Optional[CameraPose] = None
    for pose in poses:
        if not first_ns <= pose.stamp_ns <= last_ns:
            continue
        if before is not None and pose.segment == before.segment and seconds(pose.stamp_ns - before.stamp_ns) < PAIR_S:
            continue
        if before is not None and pose.segment == before.segment:
            T = np.linalg.inv(before.T_world_camera) @ pose.T_world_camera
            pairs.append(ImagePair(before.stamp_ns, pose.stamp_ns, pose.segment, T[:3, :3], T[:3, 3]))
        before = pose
    if not pairs:
        return pairs
    moved = wheels.motions(pairs, 0.0, 0.0, 0.0)
    return [pair for pair, motion in zip(pairs, moved) if np.hypot(*motion[:2]) > 0.02 or abs(motion[2]) > 0.02]
