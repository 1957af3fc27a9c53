# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.fusion.leaving import LeavingKeyframe
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.slam.record_maker import MOST_POSES, RecordMaker
from ceiling_dso_ros.slam.records import KeyframeView

CAMERA = PinholeCamera(100.0, 100.0, 79.5, 59.5, 160, 120)
MOUNT = np.eye(4)
MOUNT[2, 3] = 0.6
STEP = np.diag([1e-6, 1e-6, 1e-8])


def view(number):
    points = np.column_stack([np.linspace(-0.3, 0.3, 20), np.zeros(20), np.ones(20)])
    return KeyframeView.of(100 * number, number, np.full((120, 160), number, np.float32), CAMERA, points)


def pose(number, before=-1):
    """Moves by 0.1 m from keyframe to keyframe; the poses jump, as when the scale is estimated anew."""
    before_ns = None if before is None else 100 * (number - 1 if before < 0 else before)
    moved = np.array([0.0 if before is None else 0.1, 0.0, 0.0])
    absolute = np.array([5.0 + number, 0.0, 0.0])
    tilt = Tilt(np.zeros(2), np.full(2, 1e-3))
    return LeavingKeyframe(number, 100 * number, before_ns, absolute, moved, STEP, 3.0, 100 * number + 7, moved, tilt)


@pytest.fixture
def maker():
    return RecordMaker()


def take(maker):
    return maker.take(MOUNT)


def test_records_are_metric_and_continue_each_other_by_their_motions(maker):
    for number in (1, 2, 3):
        maker.add_view(view(number))
        maker.add_pose(pose(number, None if number == 1 else -1))
    records = take(maker)
    assert [new.record.stamp_ns for new in records] == [100, 200, 300]
    assert [new.begins for new in records] == [True, False, False]
    np.testing.assert_allclose([new.record.pose[0] for new in records], [6.0, 6.1, 6.2])
    np.testing.assert_allclose(records[0].record.points[:, 2], 3.6, rtol=1e-6)
    np.testing.assert_allclose(records[2].record.step_covariance, STEP, atol=1e-12)
    assert records[2].newest_ns == 307


def test_records_are_upright(maker):
    """A robot that pitches, nose down, looks ahead of itself: the ceiling above it lies behind in its own axes."""
    pitch = 0.1
    tilt = Tilt(np.array([0.0, pitch]), np.full(2, 1e-3))
    maker.add_view(view(1))
    maker.add_pose(replace(pose(1, None), tilt=tilt))
    (new,) = take(maker)
    assert new.record.tilt is tilt
    middle = new.record.points.mean(axis=0)  # 3 m along the view, which begins 0.6 m along base z
    np.testing.assert_allclose(middle, [3.6 * np.sin(pitch), 0.0, 3.6 * np.cos(pitch)], rtol=1e-6)


def test_either_may_come_first_and_a_view_that_does_not_come_is_left_out(maker):
    maker.add_pose(pose(1, None))
    maker.add_pose(pose(2))
    maker.add_pose(pose(3))
    maker.add_view(view(3))
    assert take(maker) == []
    maker.add_view(view(1))
    assert [new.record.stamp_ns for new in take(maker)] == [100]
    for number in range(4, 4 + MOST_POSES):
        maker.add_pose(pose(number))
    (third,) = take(maker)
    assert third.record.stamp_ns == 300
    np.testing.assert_allclose(third.record.pose[0], 6.2)
    np.testing.assert_allclose(third.record.step_covariance[2, 2], 2e-8)


def test_another_drive_begins_where_no_motion_is_known(maker):
    for number, before in ((1, None), (2, None), (4, 3)):
        maker.add_view(view(number))
        maker.add_pose(pose(number, before))
    assert [new.begins for new in take(maker)] == [True, True, True]
