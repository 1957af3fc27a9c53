# SPDX-License-Identifier: BSD-3-Clause
"""A small synthetic flight for the whole odometry."""

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
