# SPDX-License-Identifier: BSD-3-Clause
"""A small synthetic flight for the whole odometry."""

from dataclasses import replace

import numpy as np
from synthetic import SHARP, Surface

from ceiling_dso_ros.dso import OdometryConfig, TrackingState
from ceiling_dso_ros.dso.config import WindowConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.evaluation.alignment import AlignmentKind, align

FRAMES = 60
FRAME_NS = 33_333_333  # from image to image
SURFACE = Surface(slope=(0.1, -0.05), relief=0.1, texture=SHARP)
CONFIG = OdometryConfig(window=WindowConfig(max_keyframes=5, min_keyframes=4, candidate_points=400, active_points=500))


def pose(k):
    """T_world_camera of frame k: an arc of about one depth, with yaw and a little of everything else."""
    phase = k / FRAMES * np.pi
    T = se3.exp(np.array([0, 0, 0, 0.03 * np.sin(2 * phase), 0.03 * np.sin(3 * phase), 0.6 * phase / np.pi]))
    T[:3, 3] = [0.35 * (1 - np.cos(phase)), 0.35 * np.sin(phase), 0.05 * np.sin(2 * phase)]
    return T


def render():
    """What the camera sees."""
    return [SURFACE.render(np.linalg.inv(pose(k))).clip(0, 255) for k in range(FRAMES)]


def run(odometry, images, first=0):
    return [odometry.track(image, (first + k) * FRAME_NS) for k, image in enumerate(images)]


def tracking(statuses):
    return [status.state is TrackingState.TRACKING for status in statuses]


def ate(statuses, truth):
    """Root mean squared position error after alignment with Sim(3), in depths of the scene."""
    found = tracking(statuses)
    ours = np.array([s.T_world_camera for s in statuses if s.state is TrackingState.TRACKING])
    true = np.array([T for T, ok in zip(truth, found) if ok])
    aligned = align(ours[:, :3, 3], true[:, :3, 3], AlignmentKind.SIM3).apply(ours)
    return np.sqrt(((aligned - true)[:, :3, 3] ** 2).sum(axis=1).mean())


def same(first, second):
    """Byte for byte, but for the time it took."""
    names = (
        "stamp_ns",
        "state",
        "segment",
        "is_keyframe",
        "keyframe_id",
        "active_points",
        "candidate_points",
        "message",
    )
    for a, b in zip(first, second):
        assert [getattr(a, name) for name in names] == [getattr(b, name) for name in names]
        for name in ("T_world_camera", "T_keyframe_camera", "covariance"):
            x, y = getattr(a, name), getattr(b, name)
            assert (x is None) == (y is None)
            assert x is None or x.tobytes() == y.tobytes()
        for k, other in zip(a.keyframes, b.keyframes):
            assert k.T_world_camera.tobytes() == other.T_world_camera.tobytes()
    assert len(first) == len(second)


def with_setting(part, **values):
    return replace(CONFIG, **{part: replace(getattr(CONFIG, part), **values)})
