# SPDX-License-Identifier: BSD-3-Clause
"""The mean wheel radius, from a drive whose scale a second camera has measured.

In the metres of the cameras, the camera's path and that of the wheels by their nominal radius differ by one factor. It
is what the calibration finds as metres per unit where the unit is a metre of the cameras. Its inverse is the factor by
which the nominal radius is wrong, as far as the cameras' geometry is right.
"""

import math
from dataclasses import replace
from typing import List, Mapping, NamedTuple, Sequence

import numpy as np

from ceiling_dso_ros.fusion.calibration_data import CameraPose
from ceiling_dso_ros.fusion.metric_scale import SegmentScale, metric_positions


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
    segments: Sequence[int], log_scales: np.ndarray, covariance: np.ndarray, scales: Mapping[int, SegmentScale]
) -> RadiusError:
    """The mean over the segments, by their variances; the error that they have in common remains.

    Args:
        segments: (n,) of the calibration.
        log_scales: (n,) of metres by the wheels per metre of the cameras.
        covariance: (n, n) of them, by wheels and motion of the camera.
        scales: of these segments, by the second camera.
    """
    of_cameras = np.array([scales[segment].sigma for segment in segments])
    information = 1.0 / (np.diag(covariance) + of_cameras**2)
    mean = float(information @ log_scales / information.sum())
    common = max(scales[segment].common_sigma for segment in segments)
    return RadiusError(-mean, math.hypot(common, 1.0 / math.sqrt(information.sum())))
