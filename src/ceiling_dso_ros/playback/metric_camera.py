# SPDX-License-Identifier: BSD-3-Clause
"""The camera's path in metres, by a second camera and without wheels."""

import math
from typing import Any, Dict

import numpy as np

from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.metric_scale import metric_positions, segment_scales
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder


def metric_camera(recorder: TrajectoryRecorder, config: FusionConfig = FusionConfig()) -> Trajectory:
    """T_world_camera of the tracked frames in metres, with the last estimate of their keyframes.

    Frames of segments in which the second camera has not told the scale are left out.
    """
    stamps_ns, segments, T = recorder.final_matrices()
    positions = metric_positions(stamps_ns, segments, T[:, :3, 3], segment_scales(recorder.estimates.values(), config))
    T[:, :3, 3] = positions
    known = np.isfinite(positions).all(axis=1)
    return Trajectory.from_matrices(stamps_ns[known], T[known])


def scale_summary(recorder: TrajectoryRecorder, config: FusionConfig = FusionConfig()) -> Dict[str, Any]:
    """Metres per unit at the end of the last segment whose scale is known, as the summary of a run has it."""
    scales = segment_scales(recorder.estimates.values(), config)
    if not scales:
        return {"value": None, "sigma": None, "converged": False}
    last = scales[max(scales)]
    sigma = math.hypot(last.sigma, last.common_sigma)
    value = math.exp(last.log_scales[-1])
    return {"value": value, "sigma": sigma, "converged": sigma < config.scale.converged_sigma}
