# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso import HostedPoints, KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.smoothing import SmoothedNode
from ceiling_dso_ros.playback.keyframe_recorder import KeyframeRecorder

CAMERA = PinholeCamera(100.0, 100.0, 79.5, 59.5, 160, 120)
OFFSET_NS = 5_000_000
NO_SIGMA = np.zeros((3, 3))


def points(host, count, depth):
    x, y = np.linspace(-0.4, 0.4, count), np.linspace(-0.3, 0.3, count)
    return HostedPoints(
        np.full(count, host),
        np.column_stack([x * depth, y * depth, np.full(count, depth)]),
        np.zeros(count, np.float32),
    )


def keyframe(number, x, leaves=False, segment=0):
    T = np.eye(4)
    T[0, 3] = x
    return KeyframeEstimate(number, 100 * number, segment, T, (0.0, 0.0), leaves)


def status(number, keyframes, window=(), gone=(), segment=0):
    return OdometryStatus(
        100 * number, TrackingState.TRACKING, segment, np.eye(4), keyframes=tuple(keyframes),
        window_points=HostedPoints.concatenated(window), marginalized=HostedPoints.concatenated(gone),
    )  # fmt: skip


def image(level):
    return np.full((120, 160), level, np.float32)


@pytest.fixture
def recorder():
    """Keyframe 1 leaves with image 3; 2 and 3 are in the window."""
    result = KeyframeRecorder(CAMERA)
    result.add(image(10), status(1, [keyframe(1, 0.0)], [points(1, 20, 1.0)]))
    result.add(image(20), status(2, [keyframe(1, 0.0), keyframe(2, 0.1)], [points(1, 10, 1.0)], [points(1, 10, 1.0)]))
    leaving = [keyframe(1, 0.0, leaves=True), keyframe(2, 0.1), keyframe(3, 0.2)]
    result.add(image(30), status(3, leaving, [points(2, 30, 2.0)], [points(1, 10, 1.0)]))
    return result


def test_a_keyframe_that_leaves_has_its_own_image_and_the_points_of_all_that_it_sees(recorder):
    ((stamp_ns, view),) = recorder.views
    assert stamp_ns == 100
    assert (view.image == 10).all()
    assert sorted(np.round(view.points[:, 2]).tolist()) == [1.0] * 20 + [2.0] * 30
    np.testing.assert_allclose(view.points[view.points[:, 2] > 1.5, 0].mean(), 0.1, atol=1e-9)


def test_the_others_leave_at_the_end_or_with_their_segment(recorder):
    recorder.add(image(40), status(4, [keyframe(4, 0.0, segment=1)], [points(4, 5, 1.0)], segment=1))
    assert [stamp_ns for stamp_ns, _ in recorder.views] == [100, 200, 300]
    recorder.finish()
    assert [stamp_ns for stamp_ns, _ in recorder.views] == [100, 200, 300, 400]


def test_records_are_metric_and_chain_the_covariances(recorder):
    recorder.finish()
    mount = np.diag([1.0, -1.0, 1.0, 1.0])
    mount[:3, :3] = np.eye(3)
    mount[2, 3] = 0.6
    robot = RobotModel(mount, 0.5, (0.1, 0.1), 4096.0, camera_time_offset_s=OFFSET_NS / 1e9)
    step = np.diag([1e-6, 1e-6, 1e-8])
    nodes = [
        SmoothedNode(100 * number + OFFSET_NS, np.array([0.1 * number, 0.0, 0.0]), np.log(3.0), step)
        for number in (1, 2, 2.5, 3)
    ]
    records = recorder.records(nodes, robot)
    assert [record.stamp_ns for record in records] == [100, 200, 300]
    np.testing.assert_allclose(np.unique(records[0].points[:, 2]), [3.6, 6.6], rtol=1e-6)
    np.testing.assert_allclose(records[2].step_covariance, 2 * step, atol=1e-9)
    np.testing.assert_array_equal(records[1].pose, [0.2, 0.0, 0.0])
