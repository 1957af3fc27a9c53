# SPDX-License-Identifier: BSD-3-Clause
"""Motion of the camera by the wheels: a hypothesis for the tracking of the next image."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.graph import GraphEstimate
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

WOBBLE_M = 0.001  # of the base on its wheels: up and down
WOBBLE_RAD = 0.002  # roll and pitch


def predict_camera_motion(
    track: WheelTrack,
    noise: WheelNoise,
    T_base_camera: np.ndarray,
    estimate: Optional[GraphEstimate],
    start_ns: int,
    end_ns: int,
    metric: bool = False,
) -> CameraMotion:
    """The wheels' motion in the camera's frame; after the newest sample the velocity is assumed constant.

    Args:
        track: the wheels.
        noise: their error model.
        T_base_camera: (4, 4) of the camera.
        estimate: scale and constants of the wheels as known now; None before there is one, and then in metres.
        start_ns: stamp of the earlier image, on the wheels' clock.
        end_ns: stamp of the later image, likewise.
        metric: return metres instead of the unit of the scale.
    """
    constants = noise.constants_covariance(with_radius=False)
    if estimate is not None:
        constants[1:, 1:] = estimate.constants_covariance
    motion = track.motion(start_ns, min(end_ns, track.end_ns))
    if end_ns > motion.end_ns:
        further = track.newest.rate * seconds(end_ns - motion.end_ns)
        motion = noise.extend(motion, WheelStep(motion.end_ns, end_ns, further))
    shift = np.zeros(3) if estimate is None else motion.jacobian[:, 1:] @ estimate.constants
    base = planar.lift(planar.compose(motion.pose, shift))
    own = np.diag([0.0, 0.0, WOBBLE_M, WOBBLE_RAD, WOBBLE_RAD, 0.0]) ** 2
    in_plane = [0, 1, 5]
    own[np.ix_(in_plane, in_plane)] = noise.covariance(motion, constants)
    T = se3.inverse(T_base_camera) @ base @ T_base_camera
    # right-multiplied in the base -> left-multiplied on T in the camera
    move = se3.adjoint(np.ascontiguousarray(T @ se3.inverse(T_base_camera)))
    covariance = move @ own @ move.T
    normal = np.ascontiguousarray(T_base_camera[2, :3])  # the base's z axis in the camera
    in_metres = CameraMotion(T, covariance, metric=True, normal=normal)
    if metric or estimate is None:
        return in_metres
    return in_metres.in_unit(np.exp(estimate.log_scale), estimate.scale_sigma)
