# SPDX-License-Identifier: BSD-3-Clause
"""Estimates the current errors of the wheel constants while the camera tracks, for times when it does not.

The configured constants do not change. Load, tyres and floor change the true ones, which is described by a slowly
varying state c = logarithms of wheel ratio and wheel base relative to nominal. It returns to nominal over a distance
(first-order Gauss-Markov process) and is observed by the camera's yaw psi against the wheels' phi:

    c' = a c + w,    a = exp(-way / WANDER_WAY_M),    cov w = (1 - a^2) P_0,    psi - phi = J_phi c + v
"""

import math
from dataclasses import replace

import numpy as np
from filterpy.kalman import KalmanFilter

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.graph import Interval
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise

WANDER_WAY_M = 100.0  # correlation distance of c, driven by the wheels


class WheelBias:
    """Kalman filter of c over the intervals between keyframes.

    Args:
        noise: error model of the wheels; its sigmas of the constants are the initial sigmas of c.
        visual: error model of the camera.
    """

    def __init__(self, noise: WheelNoise, visual: VisualConfig) -> None:
        self._noise = noise
        self._visual = visual
        self._prior = noise.constants_covariance(with_radius=False)[1:, 1:]
        self._filter = KalmanFilter(dim_x=2, dim_z=1)
        self._filter.inv = np.reciprocal  # of a (1, 1) matrix
        self._filter.P = self._prior

    @property
    def constants(self) -> np.ndarray:
        """(2,) c."""
        return self._filter.x.ravel()

    @property
    def covariance(self) -> np.ndarray:
        """(2, 2) of c."""
        return self._filter.P

    def learn(self, interval: Interval) -> None:
        """Update with the newest interval, wheels uncorrected; intervals without camera or with slip are ignored."""
        wheels = interval.wheels
        kept = math.exp(-self._noise.way_m(wheels) / WANDER_WAY_M)
        self._filter.predict(F=kept * np.eye(2), Q=(1.0 - kept**2) * self._prior)
        if interval.visual is None or interval.wheels_slip:
            return
        of_camera = interval.visual.noise(self._visual)
        variance = wheels.noise[2, 2] + self._noise.resolution[2, 2] + of_camera[2, 2]
        turn = planar.wrap(interval.visual.yaw - wheels.pose[2])
        self._filter.update(turn, R=variance, H=wheels.jacobian[2:, 1:])

    def bridge(self, corrected: WheelMotion) -> WheelMotion:
        """A motion corrected by c, whose noise includes the uncertainty of c."""
        by_constants = corrected.jacobian[:, 1:]
        noise = corrected.noise + by_constants @ self.covariance @ by_constants.T
        radius_alone = corrected.jacobian * [1.0, 0.0, 0.0]
        return replace(corrected, noise=noise, jacobian=radius_alone)
