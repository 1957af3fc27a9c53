# SPDX-License-Identifier: BSD-3-Clause
"""The tree of a robot's frames, from recorded tf messages."""

from typing import Dict, Iterable, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.io.limits import MOST_FRAMES
from ceiling_dso_ros.io.ros_messages import RosMessage, transform_matrix

UNIT_TOLERANCE = 1e-2  # of the squared length of a quaternion, as in tf2, which ignores a transform beyond it


class StaticTransforms:
    """A tree of frames."""

    def __init__(self, messages: Iterable[RosMessage] = ()) -> None:
        """Begin with some tf2_msgs/TFMessage messages; see `add`."""
        self._parents: Dict[str, Tuple[str, np.ndarray]] = {}
        for message in messages:
            self.add(message)

    def add(self, message: RosMessage) -> None:
        """Add the transforms of a tf2_msgs/TFMessage; the last one of a frame counts, what tf2 ignores is ignored."""
        for transform in message.transforms:
            q = transform.transform.rotation
            squared = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w  # q.x**2 would raise OverflowError
            if not abs(squared - 1.0) < UNIT_TOLERANCE:  # also where it is NaN
                continue
            try:
                parent, child, T_parent_child = transform_matrix(transform)
            except ValueError:
                continue
            if parent and child and parent != child:
                self._parents[child] = (parent, T_parent_child)

    @property
    def frames(self) -> List[str]:
        """All frames, sorted."""
        return sorted({*self._parents, *(parent for parent, _ in self._parents.values())})

    def lookup(self, target: str, source: str) -> Optional[np.ndarray]:
        """T_target_source (4, 4), None if the frames are not connected; a leading slash of a name does not count."""
        from_source, from_target = (self._ancestors(frame.lstrip("/")) for frame in (source, target))
        for ancestor, T_ancestor_source in from_source.items():
            if ancestor in from_target:
                return np.linalg.inv(from_target[ancestor]) @ T_ancestor_source
        return None

    def _ancestors(self, frame: str) -> Dict[str, np.ndarray]:
        """The frame and all above it, nearest first, with T_ancestor_frame."""
        poses = {frame: np.eye(4)}
        while frame in self._parents and len(poses) <= MOST_FRAMES:
            parent, T_parent_frame = self._parents[frame]
            if parent in poses:  # a loop
                break
            poses[parent] = T_parent_frame @ poses[frame]
            frame = parent
        return poses
