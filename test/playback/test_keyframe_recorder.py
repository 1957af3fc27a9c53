# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso import HostedPoints, KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.playback.keyframe_recorder import KeyframeRecorder
from ceiling_dso_ros.slam.records import KeyframeView

CAMERA = PinholeCamera(100.0, 100.0, 79.5, 59.5, 160, 120)


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
    first = status(1, [keyframe(1, 0.0)], [points(1, 20, 1.0)])
    second = status(2, [keyframe(1, 0.0), keyframe(2, 0.1)], [points(1, 10, 1.0)], [points(1, 10, 1.0)])
    assert result.add(image(10), first) == result.add(image(20), second) == []
    return result


@pytest.fixture
def left(recorder):
    leaving = [keyframe(1, 0.0, leaves=True), keyframe(2, 0.1), keyframe(3, 0.2)]
    return recorder.add(image(30), status(3, leaving, [points(2, 30, 2.0)], [points(1, 10, 1.0)]))


def test_a_keyframe_that_leaves_has_its_own_image_and_the_points_of_all_that_it_sees(left):
    (view,) = left
    assert (view.stamp_ns, view.keyframe_id) == (100, 1)
    assert (view.image == 10).all()
    assert sorted(np.round(view.points[:, 2]).tolist()) == [1.0] * 20 + [2.0] * 30
    np.testing.assert_allclose(view.points[view.points[:, 2] > 1.5, 0].mean(), 0.1, atol=1e-6)


def test_the_others_leave_with_their_segment(recorder, left):
    later = recorder.add(image(40), status(4, [keyframe(4, 0.0, segment=1)], [points(4, 5, 1.0)], segment=1))
    assert [view.stamp_ns for view in later] == [200, 300]


def test_large_images_are_made_smaller(recorder):
    camera = PinholeCamera(500.0, 500.0, 423.5, 239.5, 848, 480)
    view = KeyframeView.of(1, 1, np.full((480, 848), 7, np.float32), camera, np.ones((3, 3)))
    assert view.image.shape == (240, 424)
    assert view.camera == PinholeCamera(250.0, 250.0, 211.5, 119.5, 424, 240)
