# SPDX-License-Identifier: BSD-3-Clause
"""Intervals of the factor graph as a winding drive gives them."""

from dataclasses import replace

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig, GraphConfig, WheelConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

BASE, LEVER, SCALE = 0.5, np.array([0.18, 0.04, 0.62]), 4.3
NOISE = WheelNoise(WheelConfig(), BASE, 1e-4)


def config(window=20, **parts):
    return FusionConfig(graph=GraphConfig(window=window), **parts)


def chain(count, rng=None, wheel_turn=0.0, segment_at=None):
    """Intervals of a winding drive, and the true poses; wheels turn wheel_turn rad per metre too much."""
    intervals, poses, scale = [], [np.zeros(3)], SCALE
    for end in range(1, count + 1):
        twist = np.array([0.15, 0.0, 0.1 * np.sin(0.3 * end)])
        poses.append(planar.compose(poses[-1], planar.expmap(twist)))
        seen = np.array([0.15, 0.0, twist[2] + 0.15 * wheel_turn])
        step = WheelStep((end - 1) * 10**9, end * 10**9, seen)
        noise = np.zeros(3)
        if rng is not None:
            noise = rng.normal(size=3) * [1.5e-4, 1.5e-4, 2e-4]
            step = replace(step, twist=seen + np.linalg.cholesky(NOISE.white(step)) @ rng.normal(size=3))
        wheels = NOISE.extend(WheelMotion.nothing((end - 1) * 10**9), step)
        first = end == 1 or end == segment_at
        scale = 1.4 * SCALE if segment_at is not None and end >= segment_at else SCALE
        camera = planar.lift(planar.expmap(twist))
        turned = camera[:3, :3] @ LEVER - LEVER
        visual = VisualMotion(
            (camera[:2, 3] + turned[:2]) / scale + noise[:2], 0.0, twist[2] + noise[2], np.zeros(2), LEVER
        )
        intervals.append(Interval(end, end * 10**9, wheels, None if first else visual, continues=not first))
    return intervals, poses
