# SPDX-License-Identifier: BSD-3-Clause
"""Images that show nothing of the motion: what they cost, and what comes after them."""

import numpy as np
import pytest
from flying import CONFIG, FRAME_NS, FRAMES, ate, pose, run, same, tracking, with_setting
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso import DirectOdometry, TrackingState

pytestmark = pytest.mark.long(minutes=2)

NOISE = np.random.default_rng(0).uniform(0, 255, (240, 320)).astype(np.float32)
GARBAGE = {
    "black": np.zeros((240, 320), np.float32),
    "white": np.full((240, 320), 255, np.uint8),
    "nan": np.full((240, 320), np.nan, np.float32),
    "infinite": np.full((240, 320), np.inf, np.float32),
    "huge": np.full((240, 320), 3e38, np.float32),
    "negative": -1e6 * NOISE,
    "noise": NOISE,
}


@pytest.mark.parametrize("kind", GARBAGE)
@pytest.mark.parametrize("number", [1, 5])
def test_garbage_has_no_pose_and_does_not_cost_the_map(images, kind, number):
    odometry = DirectOdometry(CAMERA, CONFIG)
    assert run(odometry, images[:25])[-1].state is TrackingState.TRACKING
    for bad in run(odometry, [GARBAGE[kind]] * number, first=25):
        assert bad.state is TrackingState.RETRYING
        assert bad.T_world_camera is None
        assert bad.message
    after = run(odometry, images[25 + number :], first=25 + number)
    assert all(tracking(after))
    assert {status.segment for status in after} == {0}
    assert ate(after, [pose(k) for k in range(25 + number, FRAMES)]) < 0.005


@pytest.mark.parametrize("kind", GARBAGE)
def test_garbage_for_longer_than_a_second_is_a_loss_and_then_a_new_segment_starts(images, kind):
    odometry = DirectOdometry(CAMERA, CONFIG)
    before = run(odometry, images[:25])
    bad = run(odometry, [GARBAGE[kind]] * 31, first=25)
    assert [status.state for status in bad] == [TrackingState.RETRYING] * 30 + [TrackingState.LOST]
    after = run(odometry, images[25:], first=56)
    assert after[0].state is TrackingState.RECOVERING
    assert after[-1].state is TrackingState.TRACKING
    assert {status.segment for status in (*before, *bad)} == {0}
    assert {status.segment for status in after} == {1}
    tracked = [status.keyframe_id for status in after if status.state is TrackingState.TRACKING]
    assert min(tracked) > max(status.keyframe_id for status in before)  # identities are never used again


def test_after_a_gap_the_gap_is_the_reason_of_the_loss(images):
    """Not what the image happens to lack: the camera has gone on."""
    odometry = DirectOdometry(CAMERA, CONFIG)
    run(odometry, images[:25])
    late = [odometry.track(GARBAGE["white"], (25 + k) * FRAME_NS + 8_000_000_000) for k in range(2)]
    assert [status.state for status in late] == [TrackingState.RETRYING, TrackingState.LOST]
    assert late[-1].message.startswith("no image for 8.0 s, in which the map may have gone out of view; ")


def test_without_patience_the_second_bad_image_is_a_loss(images):
    """The first one is not, whatever the time since the last pose: images may come seconds apart."""
    odometry = DirectOdometry(CAMERA, with_setting("tracking", patience=0.0))
    run(odometry, images[:25])
    bad = run(odometry, [GARBAGE["white"]] * 2, first=25)
    assert [status.state for status in bad] == [TrackingState.RETRYING, TrackingState.LOST]


def test_a_skipped_image_changes_nothing(flight, images):
    odometry = DirectOdometry(CAMERA, CONFIG)
    first = odometry.skip(0, "torn")
    assert (first.state, first.message) == (TrackingState.INITIALIZING, "torn")
    statuses = []
    for k, image in enumerate(images):
        statuses.append(odometry.track(image, k * FRAME_NS))
        skipped = odometry.skip(k * FRAME_NS + 1, "torn")
        assert (skipped.stamp_ns, skipped.T_world_camera, skipped.message) == (k * FRAME_NS + 1, None, "torn")
    assert skipped.state is TrackingState.RETRYING
    same(flight, statuses)


@pytest.mark.parametrize(("gain", "offset"), [(0.25, 5.0), (0.4, 80.0), (1.6, -60.0)])
def test_light_that_changes_at_once_and_back_does_not_cost_the_map(images, gain, offset):
    """Lamps that are switched between two images, and nothing known of exposures."""
    odometry = DirectOdometry(CAMERA, CONFIG)
    relit = [image if (k // 8) % 2 == 0 or k < 20 else gain * image + offset for k, image in enumerate(images)]
    statuses = run(odometry, [image.astype(np.float32) for image in relit])
    begun = tracking(statuses).index(True)
    assert all(tracking(statuses[begun:]))
    assert ate(statuses, [pose(k) for k in range(FRAMES)]) < 0.006


def test_exposures_that_are_unknown_now_and_then_do_not_matter(images):
    """Unknown is not one millisecond: that would be a gain of eight."""
    odometry, statuses = DirectOdometry(CAMERA, CONFIG), []
    for k, image in enumerate(images):
        statuses.append(odometry.track(image, k * FRAME_NS, None if k % 7 == 3 else 8.0))
    same(run_with_exposure(images, 8.0), statuses)


def run_with_exposure(images, exposure_ms):
    odometry = DirectOdometry(CAMERA, CONFIG)
    return [odometry.track(image, k * FRAME_NS, exposure_ms) for k, image in enumerate(images)]


@pytest.mark.parametrize("kind", GARBAGE)
def test_garbage_from_the_start_never_tracks_and_never_raises(kind):
    odometry = DirectOdometry(CAMERA, CONFIG)
    statuses = run(odometry, [GARBAGE[kind]] * 20)
    assert not any(tracking(statuses))
    assert all(np.isnan(status.rmse) for status in statuses)


def test_noise_that_changes_never_raises():
    odometry, rng = DirectOdometry(CAMERA, CONFIG), np.random.default_rng(1)
    for k in range(30):
        status = odometry.track(rng.integers(0, 256, (240, 320)).astype(np.uint8), k * FRAME_NS)
        assert status.state in TrackingState


def test_a_broken_first_image_does_not_spoil_the_flight(images):
    odometry = DirectOdometry(CAMERA, CONFIG)
    run(odometry, [GARBAGE["black"]])
    assert run(odometry, images, first=1)[-1].state is TrackingState.TRACKING


@pytest.mark.parametrize("phase", [0.1, 0.5, 0.9])
def test_a_map_begins_when_the_cover_has_slid_off_the_lens(images, phase):
    """Made of images with the cover's edge, which is blurred, it would be wrong for as long as the segment lasts."""
    sliding, blur = 6, 0.04
    u = np.linspace(0.0, 1.0, CAMERA.width)

    def seen(k):
        visible = np.clip(((k + phase) / sliding * (1.0 + 2.0 * blur) - blur - u) / blur + 0.5, 0.0, 1.0)
        return (images[k] * visible + 2.0 * (1.0 - visible)).astype(np.float32)

    statuses = run(DirectOdometry(CAMERA, CONFIG), [seen(k) for k in range(len(images))])
    begun = next(status for status in statuses if status.keyframes)
    assert begun.keyframes[0].stamp_ns >= (sliding - 1) * FRAME_NS
    assert begun.stamp_ns < 30 * FRAME_NS
    assert ate(statuses, [pose(k) for k in range(len(images))]) < 0.005


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        ("tracking", {"min_texture": 1e9, "patience": 0.0}, "too little texture"),
        ("window", {"active_points": 5000, "min_active_share": 0.5}, "too few"),
    ],
)
def test_what_is_too_weak_to_be_believed_is_a_loss(images, part, values, message):
    statuses = run(DirectOdometry(CAMERA, with_setting(part, **values)), images)
    lost = [status for status in statuses if status.state is TrackingState.LOST]
    assert lost
    assert all(message in status.message and status.T_world_camera is None for status in lost)


def test_a_jump_to_another_place_has_no_pose(images):
    odometry = DirectOdometry(CAMERA, CONFIG)
    run(odometry, images[:25])
    far = Surface(slope=(0.1, -0.05), relief=0.1, texture=type(SHARP)(seed=9, shortest=0.05, contrast=40.0, waves=24))
    status = odometry.track(far.render(np.eye(4)).clip(0, 255), 25 * FRAME_NS)
    assert status.state is TrackingState.RETRYING
