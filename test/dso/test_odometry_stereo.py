# SPDX-License-Identifier: BSD-3-Clause
"""The odometry with a second camera: keyframes say how many metres a unit is."""

import numpy as np
import pytest
from flying import CONFIG, FRAME_NS, SURFACE, pose, same
from synthetic import CAMERA

from ceiling_dso_ros.dso import DirectOdometry, StereoRig
from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler

METRES = 3.0  # in a depth of the scene
BASELINE = 0.03  # depths


@pytest.fixture(scope="module")
def rig():
    T = np.eye(4)
    T[0, 3] = METRES * BASELINE
    return StereoRig(CAMERA, T)


@pytest.fixture(scope="module")
def rights(images):
    beside = np.eye(4)
    beside[0, 3] = BASELINE
    return [SURFACE.render(np.linalg.inv(pose(k) @ beside)).clip(0, 255) for k in range(len(images))]


def run(odometry, images, rights):
    return [
        odometry.track(image, k * FRAME_NS, right=None if right is None else lambda right=right: right)
        for k, (image, right) in enumerate(zip(images, rights))
    ]


@pytest.fixture(scope="module")
def seen_twice(images, rights, rig):
    return run(DirectOdometry(CAMERA, CONFIG, rig=rig), images, rights)


def last_estimates(statuses):
    return {keyframe.keyframe_id: keyframe for status in statuses for keyframe in status.keyframes}


def true_scale(keyframe, other):
    """Metres per unit, by the way from one keyframe to another."""
    ours = np.linalg.norm(keyframe.T_world_camera[:3, 3] - other.T_world_camera[:3, 3])
    truth = [pose(each.stamp_ns // FRAME_NS)[:3, 3] for each in (keyframe, other)]
    return METRES * np.linalg.norm(truth[0] - truth[1]) / ours


def test_keyframes_say_the_scale_of_the_path(seen_twice):
    keyframes = list(last_estimates(seen_twice).values())
    told = [keyframe for keyframe in keyframes if np.isfinite(keyframe.scale.log_scale)]
    assert len(told) > 0.7 * len(keyframes)
    truth = np.log(true_scale(keyframes[-1], keyframes[1]))
    for keyframe in told[-4:]:
        assert keyframe.scale.log_scale == pytest.approx(truth, abs=0.02)
        assert 0.0 < keyframe.scale.sigma < 0.02
        assert keyframe.scale.common_sigma > CONFIG.rig.baseline_sigma


def test_poses_owe_nothing_to_the_second_camera(seen_twice, flight):
    same(seen_twice, flight)


def test_images_that_are_missing_cost_only_their_scale(images, rights, rig, flight):
    taken = sorted(k.stamp_ns // FRAME_NS for k in last_estimates(flight).values())
    missing = set(taken[::2])
    some = [None if k in missing else right for k, right in enumerate(rights)]
    statuses = run(DirectOdometry(CAMERA, CONFIG, rig=rig), images, some)
    same(statuses, flight)
    told = {k.stamp_ns // FRAME_NS for k in last_estimates(statuses).values() if np.isfinite(k.scale.log_scale)}
    assert told
    assert not told & missing


def test_the_scale_also_comes_from_a_mapping_beside_the_tracking(images, rights, rig):
    scheduler = LiveScheduler()
    odometry = DirectOdometry(CAMERA, CONFIG, scheduler, rig)
    statuses = []
    for k, (image, right) in enumerate(zip(images, rights)):
        statuses.append(odometry.track(image, k * FRAME_NS, right=lambda right=right: right))
        scheduler.wait()
    scheduler.close()
    told = [k for k in last_estimates(statuses).values() if np.isfinite(k.scale.log_scale)]
    assert len(told) > 3


def test_without_a_rig_right_images_are_not_asked_for(images, flight):
    def never():
        raise AssertionError

    odometry = DirectOdometry(CAMERA, CONFIG)
    same([odometry.track(image, k * FRAME_NS, right=never) for k, image in enumerate(images[:20])], flight[:20])
