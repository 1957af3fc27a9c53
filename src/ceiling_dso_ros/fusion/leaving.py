# SPDX-License-Identifier: BSD-3-Clause
"""The metric poses of the keyframes that leave the odometry's window, for a map of the site.

A keyframe leaves when it is refined for the last time. Its motion from the one before is of one solution of the graph:
poses of two solutions may differ by more than the motion between them, because the scale is estimated anew. Some leave
after later ones. Their motion leads back, and that of the next one forward again, so both have the errors in between.
"""

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np

from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.graph import WindowGraph
from ceiling_dso_ros.fusion.keyframes import KeyframeChain
from ceiling_dso_ros.fusion.tilt import Tilt, TiltFilter

MOST_WAITING = 200  # keyframes that leave before the graph has its next node


@dataclass(frozen=True)
class LeavingKeyframe:
    """A keyframe at its last estimate. One that leaves when the graph has forgotten it is left out.

    Attributes:
        keyframe_id: as the odometry counts.
        image_ns: stamp of its image, on the camera's clock.
        before_ns: the same of the one that left before; None where a chain begins.
        pose: (3,) of base_link relative to the first wheel sample.
        motion: (3,) of base_link from the one before; zero where a chain begins.
        covariance: (3, 3) of it, the scale taken as exact, as in `fusion.planar`.
        metres_per_unit: of the visual odometry.
        newest_ns: stamp of the newest keyframe, on the wheels' clock.
        to_newest: (3,) motion of base_link from this keyframe to the newest one.
        tilt: of base_link against the plane of motion.
    """

    keyframe_id: int
    image_ns: int
    before_ns: Optional[int]
    pose: np.ndarray
    motion: np.ndarray
    covariance: np.ndarray
    metres_per_unit: float
    newest_ns: int
    to_newest: np.ndarray
    tilt: Tilt


@dataclass(frozen=True)
class _Node:
    """A keyframe that leaves, and its node in the graph."""

    number: int
    keyframe: KeyframeEstimate


class LeavingKeyframes:
    """Follows the keyframes that leave the window.

    Args:
        graph: with the nodes of the keyframes.
        chain: which says what node a keyframe is.
        config: the errors of the odometry.
    """

    def __init__(self, graph: WindowGraph, chain: KeyframeChain, config: VisualConfig) -> None:
        self._graph, self._chain = graph, chain
        self._tilts = TiltFilter(config)
        self._window: Dict[int, KeyframeEstimate] = {}
        self._waiting: List[_Node] = []
        self._known: Dict[int, bool] = {}  # segment -> whether its scale was known at last
        self._last: Optional[KeyframeEstimate] = None  # that left
        self._since = 0  # node of the graph's window from which the motion since then is still to be taken
        self._motion, self._covariance = np.zeros(3), np.zeros((3, 3))  # from the last one to that node
        self._left: Set[int] = set()  # nodes of the graph's window that have left

    def refine(self, keyframes: Sequence[KeyframeEstimate]) -> None:
        """Hear of the window before the chain does: all keyframes of another segment leave."""
        if self._window and keyframes[-1].segment != next(iter(self._window.values())).segment:
            self._note(list(self._window.values()))
            self._window = {}
        if self._last is not None and keyframes[-1].keyframe_id < self._last.keyframe_id:
            self._last = None  # the odometry counts anew: another chain

    def refined(self, keyframes: Sequence[KeyframeEstimate]) -> None:
        """Hear of the window after the chain."""
        self._note([keyframe for keyframe in keyframes if keyframe.leaves])
        self._window = {keyframe.keyframe_id: keyframe for keyframe in keyframes if not keyframe.leaves}

    def solved(self, segment: int, scale_known: bool, newest_ns: int) -> List[LeavingKeyframe]:
        """The graph has a new node: those that have left since the last one, in their order.

        Args:
            segment: of the new node.
            scale_known: whether its scale is known.
            newest_ns: its stamp.
        """
        self._known = {number: known for number, known in self._known.items() if number >= segment - 1}
        self._known[segment] = scale_known
        waiting = sorted({node.number: node for node in self._waiting}.values(), key=lambda node: node.number)
        self._waiting, self._left = [], {number for number in self._left if number > self._graph.oldest}
        tilts = self._tilts_of_window() if waiting else {}
        result = [self._leave(node, newest_ns, tilts[node.number]) for node in waiting if self._is_usable(node)]
        while self._last is not None and self._since == self._graph.oldest < self._graph.newest:
            self._advance(self._since + 1)
        first = self._graph.intervals[0]
        self._tilts.settle(first, self._metres_per_unit(first.end))
        return result

    def _note(self, keyframes: Sequence[KeyframeEstimate]) -> None:
        for keyframe in keyframes:
            number = self._chain.node_of(keyframe.keyframe_id)
            if number is not None:
                self._waiting.append(_Node(number, keyframe))
        del self._waiting[:-MOST_WAITING]

    def _is_usable(self, node: _Node) -> bool:
        is_kept = node.number > self._graph.oldest and node.number not in self._left
        return is_kept and self._known.get(node.keyframe.segment, False)

    def _tilts_of_window(self) -> Dict[int, Tilt]:
        intervals = self._graph.intervals
        return self._tilts.smoothed(intervals, [self._metres_per_unit(interval.end) for interval in intervals])

    def _metres_per_unit(self, node: int) -> float:
        return float(np.exp(self._graph.log_scale(node)))

    def _leave(self, node: _Node, newest_ns: int, tilt: Tilt) -> LeavingKeyframe:
        before = self._last
        if before is None:
            self._since, self._motion, self._covariance = node.number, np.zeros(3), np.zeros((3, 3))
        else:
            self._advance(node.number)
        pose = self._graph.pose(node.number)
        result = LeavingKeyframe(
            node.keyframe.keyframe_id,
            node.keyframe.stamp_ns,
            None if before is None else before.stamp_ns,
            pose,
            self._motion,
            self._covariance,
            self._metres_per_unit(node.number),
            newest_ns,
            planar.between(pose, self._graph.pose(self._graph.newest)),
            tilt,
        )
        self._last = node.keyframe
        self._left.add(node.number)
        self._motion, self._covariance = np.zeros(3), np.zeros((3, 3))
        return result

    def _advance(self, node: int) -> None:
        """Take the motion up to a node, which may be an earlier one, before it leaves the graph's window."""
        if node >= self._since:
            motion, covariance = self._moved(self._since, node)
        else:
            ahead, covariance = self._moved(node, self._since)
            motion, turned = planar.inverse(ahead), planar.adjoint(ahead)
            covariance = turned @ covariance @ turned.T
        back = planar.adjoint(planar.inverse(motion))
        self._motion = planar.compose(self._motion, motion)
        self._covariance = back @ self._covariance @ back.T + covariance
        self._since = node

    def _moved(self, start: int, end: int) -> Tuple[np.ndarray, np.ndarray]:
        """(3,) motion from a node to a later one by the graph, and its (3, 3) covariance."""
        motion = planar.between(self._graph.pose(start), self._graph.pose(end))
        covariance = np.zeros((3, 3))
        for number, of_step in enumerate(self._graph.step_covariances(start, end), start + 1):
            step = planar.between(self._graph.pose(number - 1), self._graph.pose(number))
            back = planar.adjoint(planar.inverse(step))
            covariance = back @ covariance @ back.T + of_step
        return motion, covariance
