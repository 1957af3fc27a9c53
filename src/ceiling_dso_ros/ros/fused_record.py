"""The trajectories that fusion_node has published, for its service ~save_trajectory."""

from array import array
from typing import Dict, Sequence

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.graph import SmoothedNode
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.io.trajectory import Trajectory

COLUMNS = 7  # stamp, fused x, y, yaw, wheels' x, y, yaw


class FusedRecord:
    """Every output, in 56 bytes."""

    def __init__(self) -> None:
        self._rows = array("d")

    def add(self, state: FusedState, wheel_pose: np.ndarray) -> None:
        """Remember an output and the (3,) pose by the wheels alone."""
        self._rows.extend((state.stamp_s, *state.pose, *wheel_pose))

    def trajectories(self, smoothed: Sequence[SmoothedNode]) -> Dict[str, Trajectory]:
        """wheel, fused and fused_smoothed, as the offline run writes them."""
        rows = np.reshape(self._rows, (-1, COLUMNS))
        return {
            "wheel": _trajectory(rows[:, 0], rows[:, 4:]),
            "fused": _trajectory(rows[:, 0], rows[:, 1:4]),
            "fused_smoothed": _trajectory([node.stamp_s for node in smoothed], [node.pose for node in smoothed]),
        }


def _trajectory(stamps_s: Sequence[float], poses: Sequence[np.ndarray]) -> Trajectory:
    return Trajectory.from_matrices(stamps_s, [planar.lift(pose) for pose in poses])
