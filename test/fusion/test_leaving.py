# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso import KeyframeEstimate
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.leaving import LeavingKeyframes

STEP = np.array([0.1, 0.01, 0.05])
COVARIANCE = np.diag([1e-6, 1e-6, 1e-8])


class Graph:
    """Keyframe k is node k + 1; all steps are the same; each solution places its nodes somewhere else."""

    def __init__(self, window):
        self._window, self.newest, self.shift_m = window, 0, 0.0

    @property
    def oldest(self):
        return max(0, self.newest - self._window)

    @property
    def intervals(self):
        return [Interval(end, 100 * end, None) for end in range(self.oldest + 1, self.newest + 1)]

    def pose(self, node):
        assert self.oldest <= node <= self.newest
        pose = np.array([self.shift_m, 0.0, 0.0])
        for _ in range(node):
            pose = planar.compose(pose, STEP)
        return pose

    def log_scale(self, node):
        assert self.oldest < node <= self.newest
        return np.log(3.0)

    def step_covariances(self, start, end):
        assert self.oldest <= start < end
        return np.repeat(COVARIANCE[None], end - start, axis=0)

    def node_of(self, keyframe_id):
        return keyframe_id + 1 if keyframe_id < self.newest else None


class Drive:
    def __init__(self, window=20):
        self.graph = Graph(window)
        self.leaving = LeavingKeyframes(self.graph, self.graph, VisualConfig())
        self.known = True

    def keyframe(self, number, leaving=(), segment=0, kept=()):
        """A new keyframe; the window has some others, and those that leave."""
        members = sorted({*leaving, *kept, number})
        keyframes = tuple(KeyframeEstimate(n, 100 * n, segment, np.eye(4), (0.0, 0.0), n in leaving) for n in members)
        self.leaving.refine(keyframes)
        self.leaving.refined(keyframes)
        self.graph.newest = number + 1
        self.graph.shift_m += 1.0
        return self.leaving.solved(segment, self.known, 100 * number)


def motion_of(steps):
    pose = np.zeros(3)
    for _ in range(steps):
        pose = planar.compose(pose, STEP)
    return pose


@pytest.mark.parametrize("window", [20, 3])
def test_motions_are_of_one_solution_even_where_a_node_has_left_the_graph(window):
    drive = Drive(window)
    drive.keyframe(0)
    drive.keyframe(1, kept=[0])
    (first,) = drive.keyframe(2, leaving=[0])
    assert (first.keyframe_id, first.image_ns, first.before_ns, first.newest_ns) == (0, 0, None, 200)
    np.testing.assert_allclose(first.to_newest, motion_of(2), atol=1e-12)
    for number in range(3, 9):
        assert drive.keyframe(number) == []
    (second,) = drive.keyframe(9, leaving=[7])
    assert second.before_ns == 0
    np.testing.assert_allclose(second.motion, motion_of(7), atol=1e-12)
    assert second.covariance[0, 0] >= 7e-6
    np.testing.assert_allclose(second.metres_per_unit, 3.0)


def test_the_motion_to_one_that_leaves_after_a_later_one_leads_back():
    drive = Drive()
    for number in range(6):
        drive.keyframe(number)
    (late,) = drive.keyframe(6, leaving=[4])
    (early,) = drive.keyframe(7, leaving=[1])
    assert (early.keyframe_id, early.before_ns) == (1, 400)
    np.testing.assert_allclose(early.motion, planar.inverse(motion_of(3)), atol=1e-12)
    ahead = planar.adjoint(motion_of(3))
    there = sum(
        back @ COVARIANCE @ back.T for back in (planar.adjoint(planar.inverse(motion_of(steps))) for steps in range(3))
    )
    np.testing.assert_allclose(early.covariance, ahead @ there @ ahead.T, atol=1e-12)
    np.testing.assert_allclose(planar.compose(late.pose, early.motion)[2], early.pose[2], atol=1e-12)
    (next_one,) = drive.keyframe(8, leaving=[5])
    assert next_one.before_ns == 100
    np.testing.assert_allclose(next_one.motion, motion_of(4), atol=1e-12)


def test_one_that_leaves_when_the_graph_has_forgotten_it_is_left_out():
    drive = Drive(window=4)
    for number in range(8):
        drive.keyframe(number)
    assert [left.keyframe_id for left in drive.keyframe(8, leaving=[6])] == [6]
    assert drive.keyframe(9, leaving=[2]) == []
    (third,) = drive.keyframe(10, leaving=[7])
    assert third.before_ns == 600


def test_one_that_is_said_to_leave_again_has_left():
    drive = Drive()
    for number in range(6):
        drive.keyframe(number)
    assert [left.keyframe_id for left in drive.keyframe(6, leaving=[2, 4])] == [2, 4]
    assert drive.keyframe(7, leaving=[4]) == []
    assert drive.keyframe(8, leaving=[2]) == []


def test_nothing_is_said_before_the_scale_is_known():
    drive = Drive()
    drive.known = False
    drive.keyframe(0)
    assert drive.keyframe(1, leaving=[0]) == []
    drive.known = True
    (left,) = drive.keyframe(2, leaving=[1])
    assert left.before_ns is None


def test_all_leave_with_their_segment():
    drive = Drive()
    drive.keyframe(0)
    drive.keyframe(1, kept=[0])
    drive.known = False  # of the new segment
    left = drive.keyframe(2, segment=1)
    assert [keyframe.keyframe_id for keyframe in left] == [0, 1]


def test_an_odometry_that_counts_anew_begins_another_chain():
    drive = Drive()
    for number in range(3):
        drive.keyframe(number)
    assert drive.keyframe(5, leaving=[4]) == []  # it is no node
    (left,) = drive.keyframe(6, leaving=[3])
    assert left.before_ns is None
    drive.leaving.refine((KeyframeEstimate(0, 10_000, 0, np.eye(4), (0.0, 0.0), False),))
    (again,) = drive.keyframe(8, leaving=[6])
    assert again.before_ns is None
