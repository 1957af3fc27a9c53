# SPDX-License-Identifier: BSD-3-Clause
"""Stores the fusion's outputs, for offline runs and fusion_node's service ~save_trajectory."""

from array import array
from typing import Iterable, Sequence

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.smoothing import SmoothedNode
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.io.trajectory import Trajectory


class FusedRecord:
    """The stamp, the fused pose and the wheels' pose of every output, in 56 bytes."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._fused = array("d")  # x, y, yaw
        self._wheel = array("d")

    def add(self, state: FusedState, wheel_pose: np.ndarray) -> None:
        """Store an output, and the (3,) pose by the wheels alone."""
        self._stamps_ns.append(state.stamp_ns)
        self._fused.extend(state.pose)
        self._wheel.extend(wheel_pose)

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def wheel(self) -> Trajectory:
        """The wheels alone, at every sample but the first: base_link in odom."""
        return planar_trajectory(self._stamps_ns, np.reshape(self._wheel, (-1, 3)))

    def fused(self) -> Trajectory:
        """What was published: base_link in odom."""
        return planar_trajectory(self._stamps_ns, np.reshape(self._fused, (-1, 3)))


def smoothed_trajectory(nodes: Sequence[SmoothedNode]) -> Trajectory:
    """The keyframes by the graph: base_link in odom."""
    return planar_trajectory([node.stamp_ns for node in nodes], [node.pose for node in nodes])


def planar_trajectory(stamps_ns: Sequence[int], poses: Iterable[np.ndarray]) -> Trajectory:
    """Trajectory of stamps and (3,) poses."""
    return Trajectory.from_matrices(stamps_ns, [planar.lift(pose) for pose in poses])
