# SPDX-License-Identifier: BSD-3-Clause
"""The factors of the graph that GTSAM does not have, with analytic Jacobians.

Variables: x_i, pose of the base in odom (gtsam.Pose2); l_i, logarithm of the scale at keyframe i (double); optional c,
logarithms of wheel ratio and wheel base relative to nominal (2-vector); optional g, correction of the camera's yaw
(double). With x_i^-1 x_j = (t, phi), R(phi) the rotation, S = R(90 degrees), and increments on the right of a pose:

    dt = [-I | -S t] dx_i + [R(phi) | 0] dx_j,    dphi = [0 0 -1] dx_i + [0 0 1] dx_j
"""

import math
from typing import List, Optional, Tuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, G, L, X

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion

WHEEL_KEY = C(0)  # c
CAMERA_YAW_KEY = G(0)  # g

pose_key = X
scale_key = L


def visual_factor(
    keys: Tuple[int, int, int], visual: VisualMotion, noise: gtsam.noiseModel.Base, camera_yaw: bool
) -> gtsam.CustomFactor:
    """Relative motion of the camera between keyframes i and j, with unknown scale.

    The error is in VO units, in which the camera's noise is constant, so that noise does not bias the scale:

        e_t = R(g) u - exp(-l_j) (t + (R(phi) - I) a + h q),    e_phi = psi - phi

    with the measured shift u, yaw psi and tilt q; a and h are the camera's position and height in the base.

    Args:
        keys: of x_i, x_j, l_j.
        visual: the measurement.
        noise: of (e_t, e_phi), units and rad.
        camera_yaw: whether the variable g exists.
    """
    u, v = (float(value) for value in visual.shift)
    ax, ay = (float(value) for value in visual.lever_m[:2])
    swing_x, swing_y = (float(value) for value in visual.lever_m[2] * visual.tilt)

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Optional[List[np.ndarray]]) -> np.ndarray:
        # plain numbers: this runs for every keyframe in every iteration, and small arrays cost ten times as much
        relative = values.atPose2(keys[0]).between(values.atPose2(keys[1]))
        x, y, phi = relative.x(), relative.y(), relative.theta()
        c, s = math.cos(phi), math.sin(phi)
        p = math.exp(-values.atDouble(keys[2]))
        turned_x, turned_y = c * ax - s * ay, s * ax + c * ay
        predicted_x, predicted_y = p * (x + turned_x - ax + swing_x), p * (y + turned_y - ay + swing_y)
        seen_x, seen_y = u, v
        if camera_yaw:
            cg, sg = math.cos(values.atDouble(CAMERA_YAW_KEY)), math.sin(values.atDouble(CAMERA_YAW_KEY))
            seen_x, seen_y = cg * u - sg * v, sg * u + cg * v
        if jacobians is not None:
            jacobians[0] = np.array([[p, 0.0, -p * (y + turned_y)], [0.0, p, p * (x + turned_x)], [0.0, 0.0, 1.0]])
            jacobians[1] = np.array([[-p * c, p * s, p * turned_y], [-p * s, -p * c, -p * turned_x], [0.0, 0.0, -1.0]])
            jacobians[2] = np.array([[predicted_x], [predicted_y], [0.0]])
            if camera_yaw:
                jacobians[3] = np.array([[-seen_y], [seen_x], [0.0]])
        return np.array([seen_x - predicted_x, seen_y - predicted_y, planar.wrap(visual.yaw - phi)])

    return gtsam.CustomFactor(noise, [*keys, CAMERA_YAW_KEY] if camera_yaw else list(keys), error)


def calibrated_wheel_factor(
    keys: Tuple[int, int], wheels: WheelMotion, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Motion of the wheels between i and j, corrected for c to first order.

        e = local((m * J c)^-1 x_i^-1 x_j)

    with the measured motion m and its derivative J by c; local gives (x, y, yaw).

    Args:
        keys: of x_i, x_j.
        wheels: the measurement.
        noise: of e, metres and rad: the wheels' white noise.
    """
    by_calibration = wheels.jacobian[:, 1:]
    to_end = planar.inverse(wheels.pose)

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: Optional[List[np.ndarray]]) -> np.ndarray:
        t, phi = _relative(values, keys)
        to_corrected = planar.inverse(by_calibration @ values.atVector(WHEEL_KEY))
        e = planar.compose(to_corrected, planar.compose(to_end, np.array([t[0], t[1], phi])))
        if jacobians is not None:
            R = planar.rotation(to_corrected[2] + to_end[2])
            jacobians[0] = -np.eye(3)
            jacobians[0][:2, :2] = -R
            jacobians[0][:2, 2] = R @ [t[1], -t[0]]
            jacobians[1] = np.eye(3)
            jacobians[1][:2, :2] = planar.rotation(e[2])
            J = np.eye(3)
            J[:2, :2] = planar.rotation(to_corrected[2])
            J[:2, 2] = [-e[1], e[0]]
            jacobians[2] = -J @ by_calibration
        return e

    return gtsam.CustomFactor(noise, [*keys, WHEEL_KEY], error)


def wheel_factor(keys: Tuple[int, int], wheels: WheelMotion, noise: gtsam.noiseModel.Base) -> gtsam.BetweenFactorPose2:
    """Motion of the wheels between i and j as measured: e = local(m^-1 x_i^-1 x_j)."""
    return gtsam.BetweenFactorPose2(*keys, gtsam.Pose2(*wheels.pose), noise)


def _relative(values: gtsam.Values, keys: Tuple[int, ...]) -> Tuple[np.ndarray, float]:
    """Translation (2,) and turn of x_i^-1 x_j."""
    relative = values.atPose2(keys[0]).between(values.atPose2(keys[1]))
    return np.array([relative.x(), relative.y()]), relative.theta()
