# SPDX-License-Identifier: BSD-3-Clause
"""The whole odometry on a small synthetic flight: accuracy, loss, garbage, repeatability."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from flying import CONFIG, FRAME_NS, FRAMES, ate, pose, run, same, tracking, with_setting
from synthetic import CAMERA

from ceiling_dso_ros.dso import ConfigError, DirectOdometry, OdometryConfig, PinholeCamera, TrackingState
from ceiling_dso_ros.dso.config import WindowConfig
from ceiling_dso_ros.dso.geometry import se3


def test_the_flight_is_tracked_accurately(flight):
    found = tracking(flight)
    assert sum(found) > 0.7 * FRAMES
    assert all(found[found.index(True) :])
    assert {status.state for status in flight} == {TrackingState.INITIALIZING, TrackingState.TRACKING}
    assert {status.segment for status in flight} == {0}
    assert ate(flight, [pose(k) for k in range(FRAMES)]) < 0.005


def test_rotation_is_right_as_well(flight):
    start = tracking(flight).index(True)
    for k in (start + 10, FRAMES - 1):
        ours = flight[start].T_world_camera[:3, :3].T @ flight[k].T_world_camera[:3, :3]
        true = pose(start)[:3, :3].T @ pose(k)[:3, :3]
        assert np.linalg.norm(se3.log_so3(ours @ true.T)) < 0.01


def test_poses_on_the_first_map_are_known_less_well_than_later_ones(flight):
    sigmas = [np.sqrt(np.trace(s.covariance[:3, :3])) for s in flight if s.covariance is not None]
    assert np.median(sigmas[:3]) > 2.0 * np.median(sigmas[-3:])


def test_what_a_status_says(flight):
    ids = []
    for k, status in enumerate(flight):
        assert status.stamp_ns == k * FRAME_NS
        if status.state is not TrackingState.TRACKING:
            assert status.T_world_camera is None
            assert status.message
            assert status.keyframe_id == -1
            continue
        assert status.message == ""
        assert status.active_points > 100
        assert 0 < status.rmse < 10
        assert status.timing_ms["track" if k > tracking(flight).index(True) else "initialize"] > 0
        T = status.T_world_camera
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        if status.keyframes:
            assert status.is_keyframe
            newest = status.keyframes[-1]
            assert newest.keyframe_id == status.keyframe_id
            assert newest.stamp_ns == status.stamp_ns
            np.testing.assert_allclose(newest.T_world_camera, T, atol=1e-9)
            np.testing.assert_allclose(status.T_keyframe_camera, np.eye(4), atol=1e-9)
            known = {e.keyframe_id: e.T_world_camera for e in status.keyframes}
            ids.append(status.keyframe_id)
            ours = status.window_points
            assert len(ours) == status.active_points
            assert set(ours.keyframe_id.tolist()) <= {e.keyframe_id for e in status.keyframes if not e.leaves}
            assert set(status.marginalized.keyframe_id.tolist()) <= set(known)
            continue
        assert len(status.window_points) == len(status.marginalized) == 0
        if status.keyframe_id in known:
            np.testing.assert_allclose(known[status.keyframe_id] @ status.T_keyframe_camera, T, atol=1e-9)
    assert ids == sorted(set(ids))
    assert len(ids) >= 3


def test_keyframes_leave_once_and_then_never_come_back(flight):
    gone, seen = set(), set()
    for status in flight:
        here = {e.keyframe_id for e in status.keyframes}
        assert not here & gone
        assert len(here) <= CONFIG.window.max_keyframes + 1
        seen |= here
        gone |= {e.keyframe_id for e in status.keyframes if e.leaves}
    assert gone
    assert seen == set(range(len(seen)))


def test_repeating_gives_the_same_bytes(flight, images):
    same(flight, run(DirectOdometry(CAMERA, CONFIG), images))


@pytest.mark.long
def test_threads_of_the_linear_algebra_do_not_change_a_byte():
    """Its summation order depends on their number, hence on the processor."""
    script = (
        "import sys\n"
        "from flying import CONFIG, render, run\n"
        "from synthetic import CAMERA\n"
        "from ceiling_dso_ros.dso import DirectOdometry\n"
        "poses = [status.T_world_camera for status in run(DirectOdometry(CAMERA, CONFIG), render())]\n"
        "sys.stdout.write(b''.join(T.tobytes() for T in poses if T is not None).hex())\n"
    )
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    outputs = [
        subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": number},
            stdout=subprocess.PIPE,
            check=True,
        ).stdout
        for number in ("1", "2")
    ]
    assert outputs[0] == outputs[1] != b""


def test_reset_gives_the_same_bytes_again(flight, images):
    odometry = DirectOdometry(CAMERA, CONFIG)
    run(odometry, images[20:45])
    odometry.reset()
    same(flight, run(odometry, images))


def test_integer_images_are_taken_as_they_are(images):
    whole = [np.round(image).astype(np.uint8) for image in images[:30]]
    as_float = [image.astype(np.float32) for image in whole]
    same(run(DirectOdometry(CAMERA, CONFIG), whole), run(DirectOdometry(CAMERA, CONFIG), as_float))


def test_changing_exposure_and_brightness_do_not_matter(images):
    """Known exposure, unknown gain and offset drift slowly over the flight."""
    odometry, statuses = DirectOdometry(CAMERA, CONFIG), []
    for k, image in enumerate(images):
        exposure, gain, offset = 5.0 + 2 * np.sin(k / 9), np.exp(0.1 * np.sin(k / 15)), 5 * np.sin(k / 11)
        statuses.append(
            odometry.track((0.15 * exposure * gain * image + offset).astype(np.float32), k * FRAME_NS, exposure)
        )
    found = tracking(statuses)
    assert sum(found) > 0.7 * FRAMES
    assert all(found[found.index(True) :])
    assert ate(statuses, [pose(k) for k in range(FRAMES)]) < 0.006


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        ("initialization", {"max_rmse": 0.01}, "does not explain"),
        ("initialization", {"min_texture": 1e9}, "too little texture"),
        ("initialization", {"min_point_texture": 1e9}, "too little texture"),
        ("window", {"active_points": 10000}, "points only"),
    ],
)
def test_a_first_map_that_explains_nothing_is_not_taken(images, part, values, message):
    """This flight's first map is better than the limits by far; here more is asked for than it can give."""
    statuses = run(DirectOdometry(CAMERA, with_setting(part, **values)), images)
    assert {status.state for status in statuses} == {TrackingState.INITIALIZING}
    assert {status.segment for status in statuses} == {0}
    assert any(message in status.message for status in statuses)
    assert not any(status.keyframes or len(status.window_points) or len(status.marginalized) for status in statuses)


def test_an_image_of_another_size_is_refused_and_changes_nothing(flight, images):
    odometry = DirectOdometry(CAMERA, CONFIG)
    statuses = run(odometry, images[:15])
    for shape in ((480, 640), (320, 240), (240, 320, 3), (240,)):
        with pytest.raises(ValueError, match="320x240"):
            odometry.track(np.zeros(shape, np.uint8), 15 * FRAME_NS)
    with pytest.raises(ValueError, match="640x480"):
        odometry.track(np.zeros((480, 640), np.uint8), 15 * FRAME_NS)
    same(flight, statuses + run(odometry, images[15:], first=15))


@pytest.mark.parametrize(("width", "height"), [(128, 96), (641, 480), (642, 480)])
def test_images_that_cannot_be_tracked_are_refused(width, height):
    with pytest.raises(ConfigError, match=f"{width}x{height}"):
        DirectOdometry(PinholeCamera(100.0, 100.0, width / 2, height / 2, width, height))


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match=r"window\.max_keyframes"):
        DirectOdometry(CAMERA, OdometryConfig(window=WindowConfig(max_keyframes=1)))


def test_standing_still_keeps_the_pose(images):
    odometry = DirectOdometry(CAMERA, CONFIG)
    statuses = run(odometry, images[:30])
    still = run(odometry, [images[29]] * 20, first=30)
    assert all(tracking(still))
    unit = np.linalg.norm(statuses[-1].T_world_camera[:3, 3])
    drift = np.linalg.norm(still[-1].T_world_camera[:3, 3] - statuses[-1].T_world_camera[:3, 3])
    assert drift < 0.01 * unit
    assert sum(status.is_keyframe for status in still) <= 1
