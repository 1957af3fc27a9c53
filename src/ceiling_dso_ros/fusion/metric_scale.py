# SPDX-License-Identifier: BSD-3-Clause
"""The scale of the camera's path by a second camera alone, without wheels.

Within a segment the log-scales l_k of the keyframes are a random walk, as in the graph, and the second camera has
measured z_k with an error of its own. Both errors are least, in units of their standard deviations, where

    sum (l_k - l_k-1)^2 / walk_k^2 + sum rho((l_k - z_k) / sigma_k)

is least, with Huber's rho: a tridiagonal system, solved again while the weights of outliers change.
"""

import math
from dataclasses import dataclass
from typing import Dict, Iterable, List, Mapping, Sequence

import numpy as np
from scipy.linalg import solveh_banded

from ceiling_dso_ros.dso.status import KeyframeEstimate
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.graph import STANDING_SHIFT
from ceiling_dso_ros.fusion.metre import usable_scale

ITERATIONS = 50
CONVERGED = 1e-7  # of a logarithm


@dataclass(frozen=True)
class SegmentScale:
    """Metres per unit along a segment.

    Attributes:
        stamps_ns: (n,) int64 of its keyframes, increasing.
        log_scales: (n,) natural logarithms.
        sigma: standard deviation of their mean, without what all measurements have in common.
        common_sigma: of that.
    """

    stamps_ns: np.ndarray
    log_scales: np.ndarray
    sigma: float
    common_sigma: float

    def at(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Log-scales at stamps (m,), between the keyframes linear in time, beyond them as at the nearest."""
        first = self.stamps_ns[0]
        return np.interp((stamps_ns - first).astype(float), (self.stamps_ns - first).astype(float), self.log_scales)


def segment_scales(
    keyframes: Iterable[KeyframeEstimate], config: FusionConfig = FusionConfig()
) -> Dict[int, SegmentScale]:
    """Segment -> its scale, of those segments in which the second camera has measured any.

    Args:
        keyframes: all, as last refined.
        config: for the walk, and for outliers.
    """
    of_segment: Dict[int, List[KeyframeEstimate]] = {}
    for keyframe in sorted(keyframes, key=lambda each: each.stamp_ns):
        of_segment.setdefault(keyframe.segment, []).append(keyframe)
    found = {}
    for segment, members in of_segment.items():
        if any(usable_scale(keyframe) is not None for keyframe in members):
            found[segment] = _segment_scale(members, config)
    return found


def _segment_scale(keyframes: Sequence[KeyframeEstimate], config: FusionConfig) -> SegmentScale:
    told = [usable_scale(keyframe) for keyframe in keyframes]
    measured = np.array([stereo is not None for stereo in told])
    z = np.array([0.0 if stereo is None else stereo.log_scale for stereo in told])
    information = np.array([0.0 if stereo is None else stereo.sigma**-2.0 for stereo in told])
    positions = np.array([keyframe.T_world_camera[:3, 3] for keyframe in keyframes])
    ways = np.maximum(np.linalg.norm(np.diff(positions, axis=0), axis=1), STANDING_SHIFT)
    walk = 1.0 / (config.scale.walk_sigma**2 * ways)
    threshold = config.visual.robust_threshold
    diagonal = np.append(walk, 0.0) + np.append(0.0, walk)
    below = np.append(-walk, 0.0)
    log_scales = np.full(len(z), float(np.median(z[measured])))
    for _ in range(ITERATIONS):
        sizes = np.sqrt(information) * np.abs(log_scales - z)
        weights = information * threshold / np.maximum(sizes, threshold)
        banded = np.array([diagonal + weights, below])
        before, log_scales = log_scales, solveh_banded(banded, weights * z, lower=True)
        if np.abs(log_scales - before).max() < CONVERGED:
            break
    mean = np.full(len(z), 1.0 / len(z))
    variance = float(mean @ solveh_banded(banded, mean, lower=True))
    common = max(stereo.common_sigma for stereo in told if stereo is not None)
    stamps_ns = np.array([keyframe.stamp_ns for keyframe in keyframes], np.int64)
    return SegmentScale(stamps_ns, log_scales, math.sqrt(variance), common)


def metric_positions(
    stamps_ns: np.ndarray, segments: np.ndarray, positions: np.ndarray, scales: Mapping[int, SegmentScale]
) -> np.ndarray:
    """A camera's positions in metres; nan in segments without a scale.

    Every step is multiplied by the scale at its end. A segment begins where the one before ended, as the odometry has
    it: what the camera moved in between, nobody has seen.

    Args:
        stamps_ns: (n,) int64, increasing.
        segments: (n,) of each.
        positions: (n, 3) in the odometry's world, units.
        scales: as of `segment_scales`.

    Returns:
        (n, 3) float64.
    """
    gains = np.full(len(stamps_ns), np.nan)
    for segment, scale in scales.items():
        chosen = segments == segment
        gains[chosen] = np.exp(scale.at(stamps_ns[chosen]))
    steps = np.diff(positions, axis=0, prepend=np.zeros((1, 3))) * np.nan_to_num(gains)[:, None]
    return np.where(np.isfinite(gains)[:, None], np.cumsum(steps, axis=0), np.nan)
