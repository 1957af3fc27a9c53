# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.playback.visual_run import VisualRun


class FakeOdometry:
    def __init__(self):
        self.seen, self.resets = [], 0

    def track(self, image, stamp_ns, exposure_ms, prediction, right=None):
        self.seen.append((image, stamp_ns, exposure_ms, prediction))
        keyframes = (KeyframeEstimate(0, stamp_ns, 0, np.eye(4), (0.0, 0.0), False),)
        return OdometryStatus(
            stamp_ns,
            TrackingState.TRACKING,
            0,
            np.eye(4),
            None,
            True,
            0,
            np.eye(4),
            keyframes,
            timing_ms={"track": 1.5},
        )

    def skip(self, stamp_ns, reason):
        return OdometryStatus(stamp_ns, TrackingState.RETRYING, 0, message=reason)

    def reset(self):
        self.resets += 1


RAW = np.full((2, 3), 7, np.uint8)


def test_the_odometry_gets_preprocessed_images_and_their_very_stamps():
    odometry = FakeOdometry()
    tracked = VisualRun(lambda image: image + 100.0, odometry).track(RAW, 1_732_800_000_123_456_789, 2.5)
    image, stamp_ns, exposure_ms, prediction = odometry.seen[0]
    assert (stamp_ns, exposure_ms, prediction) == (1_732_800_000_123_456_789, 2.5, None)
    assert image[0, 0] == 107.0
    assert tracked.image is image
    assert set(tracked.status.timing_ms) == {"undistort", "track"}
    assert tracked.total_ms >= tracked.status.timing_ms["undistort"] >= 0.0


@pytest.mark.parametrize("keep", [True, False])
def test_the_trajectory_is_kept_when_asked_for(keep):
    run = VisualRun(lambda image: image, FakeOdometry(), keep_trajectory=keep)
    assert run.last is None
    run.track(RAW, 1, None)
    assert run.last.stamp_ns == 1
    assert {name: len(make()) for name, make in run.trajectories.files().items()} == dict.fromkeys(
        ("camera.tum", "camera_final.tum", "keyframes.tum"), int(keep)
    )


def test_a_restart_forgets_everything():
    odometry = FakeOdometry()
    run = VisualRun(lambda image: image, odometry)
    run.track(RAW, 1, None)
    run.restart()
    assert odometry.resets == 1
    assert run.last is None
    assert len(run.trajectories.live()) == 0


@pytest.mark.parametrize("buffers", [1, 2, 8])
def test_an_image_that_repeats_one_of_the_last_has_no_pose(buffers):
    """A driver that has stopped sends what is in its buffers with new stamps, again and again."""
    odometry, rng = FakeOdometry(), np.random.default_rng(0)
    run = VisualRun(lambda image: image, odometry)
    images = rng.integers(0, 256, (buffers + 12, 4, 10)).astype(np.uint8)[:, :, ::2]
    sent = [*images[:10], *[image.copy() for _ in range(3) for image in images[10 - buffers : 10]], *images[10:]]
    states = [run.track(image, k, None).status.state for k, image in enumerate(sent)]
    tracking, retrying = TrackingState.TRACKING, TrackingState.RETRYING
    assert states == [*[tracking] * 10, *[retrying] * 3 * buffers, *[tracking] * (buffers + 2)]
    assert run.last.message == ""
    assert run.last.stamp_ns == len(sent) - 1
    assert len(run.trajectories.live()) == len(images)


def test_an_image_of_long_ago_is_no_repetition():
    """As where a lamp comes and goes under a camera without noise."""
    run = VisualRun(lambda image: image, FakeOdometry())
    images = np.random.default_rng(0).integers(0, 256, (9, 4, 5)).astype(np.uint8)
    assert {run.track(image, 0, None).status.state for image in (*images, images[0])} == {TrackingState.TRACKING}


def test_black_images_are_alike_and_the_odometry_judges_them():
    odometry = FakeOdometry()
    run = VisualRun(lambda image: image, odometry)
    for k in range(3):
        run.track(np.zeros((4, 5), np.uint8), k, None)
    assert len(odometry.seen) == 3
