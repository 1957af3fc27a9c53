# SPDX-License-Identifier: BSD-3-Clause
"""Direct Sparse Odometry in numpy and numba. Knows nothing of ROS, files or wheels."""

from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.dso.odometry import DirectOdometry
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.dso.stereo.rig import StereoRig

__all__ = [
    "CameraMotion",
    "ConfigError",
    "DirectOdometry",
    "HostedPoints",
    "KeyframeEstimate",
    "OdometryConfig",
    "OdometryStatus",
    "PinholeCamera",
    "StereoRig",
    "TrackingState",
]
