# SPDX-License-Identifier: BSD-3-Clause
"""Result of the odometry for a frame."""

import enum
import math
from dataclasses import dataclass, field
from typing import Mapping, NamedTuple, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.hosted_points import NO_HOSTED_POINTS, HostedPoints


class TrackingState(enum.Enum):
    """State of the odometry after a frame."""

    INITIALIZING = "initializing"  # collecting parallax for a first map: no pose yet
    TRACKING = "tracking"  # the pose is valid
    RETRYING = "retrying"  # no pose for this frame, but the map is kept: the next one is tried on it again
    LOST = "lost"  # the map is given up; the next frame starts a new segment
    RECOVERING = "recovering"  # collecting parallax for the first map of a new segment: no pose yet


class TrackingLostError(Exception):
    """The segment ends with this image; the message says why. Only raised and caught within the odometry."""


class UntrackedImageError(Exception):
    """One image has no pose; the message says why. Only raised and caught within the odometry."""


class ScaleMeasurement(NamedTuple):
    """Metres per unit of the map at one keyframe, by a second camera.

    Attributes:
        log_scale: natural logarithm; nan where it is not known.
        sigma: standard deviation of it, by what is independent of the keyframes before.
        common_sigma: the same, by what all keyframes have in common: errors of the cameras' geometry.
    """

    log_scale: float
    sigma: float
    common_sigma: float


NO_SCALE = ScaleMeasurement(math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class KeyframeEstimate:
    """One keyframe of the window as last refined.

    Attributes:
        keyframe_id: counts up over the whole run, never reused.
        stamp_ns: stamp of its image, nanoseconds.
        segment: the segment it belongs to.
        T_world_camera: (4, 4) float64, VO units, VO world.
        affine: brightness parameters (a, b) of equation (4).
        leaves: True when it has been marginalised, so this estimate is its last.
        depth: median depth of the map's points as it saw them when it was made, VO units; nan where it saw too few.
        scale: metres per unit by a second camera, for the pose as it is here; NO_SCALE where it is not told.
    """

    keyframe_id: int
    stamp_ns: int
    segment: int
    T_world_camera: np.ndarray
    affine: Tuple[float, float]
    leaves: bool
    depth: float = float("nan")
    scale: ScaleMeasurement = NO_SCALE


@dataclass(frozen=True)
class OdometryStatus:
    """The result of `DirectOdometry.track` for one image.

    Attributes:
        stamp_ns: stamp of the image, nanoseconds.
        state: see TrackingState.
        segment: counts from 0; every re-initialisation begins a new one with its own unit of length.
        T_world_camera: (4, 4) float64 pose of the camera in the VO world, VO units; None unless state is TRACKING.
        covariance: (6, 6) float64 of (translation, rotation), left-multiplied on T_world_camera; None without a pose.
        is_keyframe: the frame became a keyframe.
        keyframe_id: the keyframe the pose is relative to, -1 without a pose.
        T_keyframe_camera: (4, 4) float64 pose relative to that keyframe; None without a pose.
        keyframes: all keyframes as refined since the last status, oldest first; empty when the window did not change.
        window_points: the window's active points; empty when the window did not change.
        marginalized: the points that were marginalised since the last status.
        rmse: photometric error of the tracking, grey levels; nan without a pose.
        active_points, candidate_points: how many the window holds.
        timing_ms: milliseconds of each stage.
        message: why there is no pose, in words; empty when tracking.
        relative_covariance: (6, 6) float64 of (translation, rotation), right-multiplied on T_keyframe_camera, so in the
            camera's own axes; None where it is unknown.
        earlier_start_ns: stamp of the image from which the motion to the next one is to be predicted, where it is not
            this one: the last one with a pose or, while there is no map, the first one of the map to come.
    """

    stamp_ns: int
    state: TrackingState
    segment: int
    T_world_camera: Optional[np.ndarray] = None
    covariance: Optional[np.ndarray] = None
    is_keyframe: bool = False
    keyframe_id: int = -1
    T_keyframe_camera: Optional[np.ndarray] = None
    keyframes: Tuple[KeyframeEstimate, ...] = ()
    window_points: HostedPoints = NO_HOSTED_POINTS
    marginalized: HostedPoints = NO_HOSTED_POINTS
    rmse: float = float("nan")
    active_points: int = 0
    candidate_points: int = 0
    timing_ms: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    relative_covariance: Optional[np.ndarray] = None
    earlier_start_ns: Optional[int] = None

    @property
    def predict_from_ns(self) -> int:
        """Stamp of the image from which the motion to the next one is to be predicted."""
        return self.stamp_ns if self.earlier_start_ns is None else self.earlier_start_ns

    @property
    def has_map(self) -> bool:
        """Whether the odometry has a map after this image."""
        return self.state in (TrackingState.TRACKING, TrackingState.RETRYING)
