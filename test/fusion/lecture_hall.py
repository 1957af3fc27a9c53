# SPDX-License-Identifier: BSD-3-Clause
"""The real dead reckoning of the recording `wheels_lecture_hall` against its truth."""

import os
from pathlib import Path

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.wheel_motion import WheelMotion, WheelNoise, WheelStep

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
FOLDER = DATA / "wheels_lecture_hall"
# Of that robot, documented in docs/fusion.md; its odometry turned 2.5 rad too little over 733 m.
NOISE = WheelConfig(noise_m_per_sqrt_m=0.005, radius_sigma=0.01, ratio_sigma=0.005, base_sigma=0.02)
WHEEL_BASE_M = 0.5


def normalised_errors():
    """(n, 3) errors of x, y and yaw in the frame of the start, each by its own standard deviation."""
    truth = np.loadtxt(FOLDER / "groundtruth.txt")
    yaw = np.unwrap(2.0 * np.arctan2(truth[:, 6], truth[:, 7]))
    truth, rates = np.column_stack([truth[:, :3], yaw]), np.loadtxt(FOLDER / "odom.txt")
    noise = WheelNoise(NOISE, WHEEL_BASE_M, 1e-4)
    constants = noise.constants_covariance(with_radius=True)
    true = np.column_stack([np.interp(rates[:, 0], truth[:, 0], column) for column in truth[:, 1:].T])
    motion, normalised, yaw_sum = WheelMotion.nothing(nanoseconds(rates[0, 0])), [], 0.0
    for before, row, pose in zip(rates, rates[1:], true[1:]):
        step = WheelStep(nanoseconds(before[0]), nanoseconds(row[0]), row[1:] * (row[0] - before[0]))
        motion = noise.extend(motion, step)
        yaw_sum += step.twist[2]
        seen = planar.between(true[0], pose)
        covariance = planar.rotate_covariance(noise.covariance(motion, constants), motion.pose[2])
        error = np.array([*(motion.pose[:2] - seen[:2]), yaw_sum - (pose[2] - true[0, 2])])
        normalised.append(error / np.sqrt(np.diag(covariance)))
    return np.array(normalised)
