# SPDX-License-Identifier: BSD-3-Clause
"""Predictions of the camera's motion since the last image, received from fusion_node."""

from typing import Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.msg import MotionPrediction
from ceiling_dso_ros.ros.conversions import covariance_from_message, matrix_from_pose

LONGEST_STRETCH = 3.0  # a prediction may be extended to this multiple of its duration


class MotionPredictions:
    """Uses the newest message of `fusion/motion_prediction`.

    Attributes:
        asked, used: number of images for which a prediction was wanted, and for which there was one.
    """

    def __init__(self) -> None:
        self._newest: Optional[MotionPrediction] = None
        self.asked = self.used = 0

    def add(self, message: MotionPrediction) -> None:
        """Store a message."""
        self._newest = message

    def between(self, start_ns: int, end_ns: int, segment: int) -> Optional[CameraMotion]:
        """Predicted motion of the camera between two image stamps of a segment; None without a prediction."""
        message, motion = self._newest, None
        if message is not None and message.start.to_nsec() == start_ns and message.segment == segment:
            motion = stretched(message, end_ns)
        self.asked += 1
        self.used += motion is not None
        return motion


def stretched(message: MotionPrediction, end_ns: int) -> Optional[CameraMotion]:
    """The predicted motion extended to another end with constant velocity.

    Its standard deviation grows in proportion. None if the values are not valid or the end is too far away.
    """
    start_ns = message.start.to_nsec()
    predicted_ns, wanted_ns = message.header.stamp.to_nsec() - start_ns, end_ns - start_ns
    if predicted_ns <= 0 or not 0 < wanted_ns <= LONGEST_STRETCH * predicted_ns:
        return None
    try:
        T_start_predicted = matrix_from_pose(message.motion)
        covariance = covariance_from_message(message.covariance)
    except ValueError:
        return None
    stretch = wanted_ns / predicted_ns
    T_start_end = se3.exp(stretch * se3.log(T_start_predicted))
    return CameraMotion(T_start_end, stretch**2 * covariance, bool(message.metric), unit_vector(message.normal))


def unit_vector(vector: Sequence[float]) -> Optional[np.ndarray]:
    """(3,) float64 in a vector's direction; None where it has none."""
    values = np.array(vector, dtype=float)
    length = np.linalg.norm(values)
    return values / length if 0.0 < length < np.inf else None
