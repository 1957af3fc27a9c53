# SPDX-License-Identifier: BSD-3-Clause
"""The static transforms of a robot, from /tf_static."""

from typing import Dict, Iterable, Optional, Tuple

import numpy as np

from ceiling_dso_ros.io.ros_messages import RosMessage, transform_matrix


class StaticTransforms:
    """A tree of frames."""

    def __init__(self, messages: Iterable[RosMessage]) -> None:
        """Read tf2_msgs/TFMessage messages; the last transform of a frame is used."""
        self._parents: Dict[str, Tuple[str, np.ndarray]] = {}
        for message in messages:
            for transform in message.transforms:
                parent, child, T_parent_child = transform_matrix(transform)
                self._parents[child] = (parent, T_parent_child)

    def lookup(self, target: str, source: str) -> Optional[np.ndarray]:
        """T_target_source (4, 4), None if the frames are not connected."""
        from_source, from_target = self._ancestors(source), self._ancestors(target)
        for ancestor, T_ancestor_source in from_source.items():
            if ancestor in from_target:
                return np.linalg.inv(from_target[ancestor]) @ T_ancestor_source
        return None

    def _ancestors(self, frame: str) -> Dict[str, np.ndarray]:
        """The frame and all above it, nearest first, with T_ancestor_frame."""
        poses = {frame: np.eye(4)}
        while frame in self._parents:
            parent, T_parent_frame = self._parents[frame]
            if parent in poses:  # a loop
                break
            poses[parent] = T_parent_frame @ poses[frame]
            frame = parent
        return poses
