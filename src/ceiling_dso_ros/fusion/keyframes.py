# SPDX-License-Identifier: BSD-3-Clause
"""Follows the keyframes of the visual odometry and the relative motions between them.

The odometry refines the keyframes of its window with every new one, and all of them together: its window may drift as a
whole. Two poses may only be compared if they come from the same status. So the motion between two consecutive
keyframes is taken from the last status that contains both; after that one of them is no longer refined. Motions between
consecutive keyframes contain all information of the chain of poses, and their errors are nearly independent.
"""

from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso.durations import LONG_AGO_NS
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.status import KeyframeEstimate


class NodeLink(NamedTuple):
    """Which keyframe a node of the graph is, or to which one it belongs.

    Attributes:
        node: number of the node.
        keyframe_id: the keyframe.
        segment: of both.
        T_keyframe_node: (4, 4) pose of the node's camera on the keyframe, VO units.
        covariance: (6, 6) of the pose of its image as it was tracked, None where it is unknown.
    """

    node: int
    keyframe_id: int
    segment: int
    T_keyframe_node: np.ndarray
    covariance: Optional[np.ndarray]

    @property
    def is_keyframe(self) -> bool:
        """Whether the node is the keyframe itself."""
        return bool((self.T_keyframe_node == np.eye(4)).all())


class Refinement(NamedTuple):
    """A refined motion: that of the camera from the keyframe before to the one of a node, (4, 4), VO units.

    Its covariance is that of the node's image: the refinement makes the motion better by an unknown amount. `keyframe`
    is that of the node.
    """

    node: int
    T_before_node: np.ndarray
    covariance: Optional[np.ndarray]
    keyframe: KeyframeEstimate


class KeyframeChain:
    """The keyframes in the odometry's window and the nodes that the graph has made of them."""

    def __init__(self) -> None:
        self._poses: Dict[int, KeyframeEstimate] = {}
        self._links: List[NodeLink] = []
        self._newest_id = -1
        self._newest_ns = LONG_AGO_NS

    @property
    def segment(self) -> int:
        """Segment of the newest node, -1 before the first."""
        return self._links[-1].segment if self._links else -1

    def update(self, keyframes: Sequence[KeyframeEstimate]) -> List[KeyframeEstimate]:
        """Take in the window as last refined, not empty; returns the keyframes that were not known, in their order."""
        newest = max(keyframes, key=lambda k: k.keyframe_id)
        if newest.keyframe_id < self._newest_id or self._counts_anew(keyframes):
            if newest.stamp_ns <= self._newest_ns:
                return []  # a window that comes late
            self._links, self._newest_id = [], -1  # the odometry was reset and counts anew
        self._poses = {keyframe.keyframe_id: keyframe for keyframe in keyframes}
        new = sorted((k for k in keyframes if k.keyframe_id > self._newest_id), key=lambda k: k.keyframe_id)
        self._newest_id, self._newest_ns = newest.keyframe_id, newest.stamp_ns
        self._links = [link for link in self._links[:-1] if link.keyframe_id in self._poses] + self._links[-1:]
        return new

    def _counts_anew(self, keyframes: Sequence[KeyframeEstimate]) -> bool:
        """Whether an id that is known means another image now."""
        known = [(k, self._poses[k.keyframe_id]) for k in keyframes if k.keyframe_id in self._poses]
        return any(k.stamp_ns != before.stamp_ns for k, before in known)

    def refinements(self) -> Iterator[Refinement]:
        """The motions between consecutive nodes that the window holds now."""
        for before, after in zip(self._links, self._links[1:]):
            if after.node == before.node + 1 and after.segment == before.segment:
                T = self._from(before, after.keyframe_id)
                if T is not None:
                    keyframe = self._poses[after.keyframe_id]
                    yield Refinement(after.node, T @ after.T_keyframe_node, after.covariance, keyframe)

    def motion_to(self, keyframe: KeyframeEstimate) -> Optional[np.ndarray]:
        """T_newest_keyframe (4, 4): motion of the camera from the newest node to a new keyframe; None if not seen."""
        if not self.continues(keyframe):
            return None
        return self._from(self._links[-1], keyframe.keyframe_id)

    def known(self, keyframe_id: int) -> Optional[KeyframeEstimate]:
        """A keyframe as last refined; None when it is not in the window."""
        return self._poses.get(keyframe_id)

    def node_of(self, keyframe_id: int) -> Optional[int]:
        """The node that a keyframe has become; None if it is none."""
        own = (link.node for link in self._links if link.keyframe_id == keyframe_id and link.is_keyframe)
        return next(own, None)

    def continues(self, keyframe: KeyframeEstimate) -> bool:
        """Whether a new keyframe is of the same segment as the newest node."""
        return bool(self._links) and self._links[-1].segment == keyframe.segment

    def link(
        self,
        node: int,
        keyframe: KeyframeEstimate,
        T_keyframe_node: Optional[np.ndarray] = None,
        covariance: Optional[np.ndarray] = None,
    ) -> None:
        """Remember which node a keyframe has become, or an image that was taken at (4, 4) T_keyframe_node.

        The covariance is that of `NodeLink`.
        """
        T = np.eye(4) if T_keyframe_node is None else T_keyframe_node
        self._links.append(NodeLink(node, keyframe.keyframe_id, keyframe.segment, T, covariance))

    def from_newest(self, keyframe_id: int, T_keyframe_camera: Optional[np.ndarray]) -> Optional[np.ndarray]:
        """T_newest_camera (4, 4) of a camera known relative to any keyframe of the newest node's segment; else None."""
        if T_keyframe_camera is None or not self._links or keyframe_id not in self._poses:
            return None
        newest = self._links[-1]
        if self._poses[keyframe_id].segment != newest.segment:
            return None
        T = self._from(newest, keyframe_id)
        return None if T is None else T @ T_keyframe_camera

    def _from(self, link: NodeLink, keyframe_id: int) -> Optional[np.ndarray]:
        """T_node_keyframe, (4, 4)."""
        T = self._relative(link.keyframe_id, keyframe_id)
        return None if T is None else se3.inverse(link.T_keyframe_node) @ T

    def _relative(self, from_id: int, to_id: int) -> Optional[np.ndarray]:
        if from_id == to_id:
            return np.eye(4)
        if from_id not in self._poses or to_id not in self._poses:
            return None
        return se3.inverse(self._poses[from_id].T_world_camera) @ self._poses[to_id].T_world_camera
