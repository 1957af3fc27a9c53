# SPDX-License-Identifier: BSD-3-Clause
"""Outputs of the fusion."""

import enum
from dataclasses import dataclass
from typing import Tuple

import numpy as np


class FusionState(enum.Enum):
    """Quality of the fused pose, which is metric in every state."""

    NOT_SCALED = "not scaled"  # the scale of the camera was never known yet: the pose is wheel odometry
    CONVERGED = "converged"  # wheels and camera agree and the scale is known
    DEGRADED = "degraded"  # one of the two is missing or faulty: the reasons say which


@dataclass(frozen=True)
class ScaleState:
    """Metres per unit of the visual odometry, for the newest keyframe's segment.

    Attributes:
        value: the estimate; nan before the first keyframe.
        sigma: relative standard deviation, the uncertainty of the mean wheel radius included; nan likewise.
        converged: it is known.
        segment: the visual odometry's segment that it holds for, -1 before the first keyframe.
    """

    value: float
    sigma: float
    converged: bool
    segment: int


@dataclass(frozen=True)
class FusedState:
    """One output of the fusion.

    Attributes:
        stamp_ns: of the newest data in it, on the wheels' clock.
        pose: (3,) x, y, yaw of base_link in odom, metres and rad.
        covariance: (3, 3) of x, y, yaw in odom.
        twist: (2,) forward speed and yaw rate of base_link, m/s and rad/s.
        twist_covariance: (2, 2).
        state: see FusionState.
        reasons: why it is not CONVERGED, each beginning with `camera:`, `wheels:` or `scale:`.
        scale: the scale now.
    """

    stamp_ns: int
    pose: np.ndarray
    covariance: np.ndarray
    twist: np.ndarray
    twist_covariance: np.ndarray
    state: FusionState
    reasons: Tuple[str, ...]
    scale: ScaleState
