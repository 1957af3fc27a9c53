# SPDX-License-Identifier: BSD-3-Clause
"""The mean wheel radius, from a drive whose scale a second camera has measured.

Between two images, wheels of the nominal radius say the way f, and the camera, in metres of the two cameras, the way g.
In turns wheels slip: they turn further than the robot moves, the more the faster it turns. And there g depends on where
the camera is in the base, which is known only as well as the same drive tells it. So

    f = exp(-r) g (1 + k |turn rate|) + y turn,

where r is the logarithm of the true radius relative to nominal, as far as the cameras' geometry is right, and neither k
nor y are known. Where a drive has hardly any straight parts, or hardly any turns, their priors count.
"""

import math
from dataclasses import replace
from typing import List, Mapping, NamedTuple, Sequence

import numpy as np

from ceiling_dso_ros.dso.compute.scatter import median_scatter
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion.calibration_data import CameraPose, ImagePair
from ceiling_dso_ros.fusion.metric_scale import SegmentScale, metric_positions

SLIP_SIGMA = 0.02  # of k in seconds: wheels that turn 2 % further at 1 rad/s slip much
SIDE_SIGMA_M = 0.1  # of y: more than a calibration is ever wrong by
ROUNDS = 20  # of weighting outliers less
HUBER = 1.345


class RadiusError(NamedTuple):
    """Logarithm of the mean wheel radius relative to nominal, with its standard deviation."""

    log_ratio: float
    sigma: float


def metric_poses(poses: Sequence[CameraPose], scales: Mapping[int, SegmentScale]) -> List[CameraPose]:
    """The camera's poses in metres of the second camera, of the segments whose scale is known."""
    known = [pose for pose in poses if pose.segment in scales]
    stamps_ns = np.array([pose.stamp_ns for pose in known], np.int64)
    segments = np.array([pose.segment for pose in known], np.int64)
    positions = np.reshape([pose.T_world_camera[:3, 3] for pose in known], (-1, 3))
    result = []
    for pose, position in zip(known, metric_positions(stamps_ns, segments, positions, scales)):
        T = pose.T_world_camera.copy()
        T[:3, 3] = position
        result.append(replace(pose, T_world_camera=T))
    return result


def radius_error(
    pairs: Sequence[ImagePair], forward: np.ndarray, turns: np.ndarray, scales: Mapping[int, SegmentScale]
) -> RadiusError:
    """By robust least squares over pairs of images.

    Args:
        pairs: (n,) of images.
        forward: (n, 2) f and g of each, metres.
        turns: (n,) rad.
        scales: of the pairs' segments, by the second camera.
    """
    by_wheels, by_cameras = forward.T
    rates = np.abs(turns) / seconds(np.array([pair.end_ns - pair.start_ns for pair in pairs], np.int64))
    columns = np.column_stack([by_cameras, by_cameras * rates, turns])
    prior = np.array([0.0, SLIP_SIGMA**-2.0, SIDE_SIGMA_M**-2.0])
    weights = np.ones(len(pairs))
    for _ in range(ROUNDS):
        scatter = _scatter(columns, weights, by_wheels)
        information = (columns * weights[:, None]).T @ columns / scatter**2 + np.diag(prior)
        found = np.linalg.solve(information, columns.T @ (weights * by_wheels) / scatter**2)
        sizes = np.abs(by_wheels - columns @ found) / scatter
        weights = HUBER / np.maximum(sizes, HUBER)
    gain = float(found[0])
    of_wheels = math.sqrt(np.linalg.inv(information)[0, 0]) / gain
    segments = [pair.segment for pair in pairs]
    shares = {segment: segments.count(segment) / len(pairs) for segment in set(segments)}
    of_cameras = math.sqrt(sum((share * scales[segment].sigma) ** 2 for segment, share in shares.items()))
    common = max(scales[segment].common_sigma for segment in shares)
    return RadiusError(-math.log(gain), math.sqrt(of_wheels**2 + of_cameras**2 + common**2))


def _scatter(columns: np.ndarray, weights: np.ndarray, by_wheels: np.ndarray) -> float:
    """Standard deviation of the residuals of the best fit, metres."""
    root = np.sqrt(weights)
    fit, *_ = np.linalg.lstsq(columns * root[:, None], by_wheels * root, rcond=None)
    return max(float(median_scatter(by_wheels - columns @ fit)), 1e-6)
