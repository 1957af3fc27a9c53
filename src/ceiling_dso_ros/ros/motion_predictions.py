"""How the camera has moved since the last image by the wheels, as fusion_node says it."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.msg import MotionPrediction
from ceiling_dso_ros.ros.conversions import matrix_from_pose, stamp_ns_of

LONGEST_STRETCH = 3.0  # a prediction is taken to go on like that for so many times its own length


class MotionPredictions:
    """The newest message of `fusion/motion_prediction` counts.

    Attributes:
        asked, used: for how many images there should have been a prediction, and for how many there was one.
    """

    def __init__(self) -> None:
        self._newest: Optional[MotionPrediction] = None
        self.asked = self.used = 0

    def add(self, message: MotionPrediction) -> None:
        """Take in a message."""
        self._newest = message

    def between(self, start_ns: int, end_ns: int, segment: int) -> Optional[CameraMotion]:
        """Motion of the camera between two images by their stamps, in a segment's unit; None when it is not known."""
        message, motion = self._newest, None
        if message is not None and stamp_ns_of(message.start) == start_ns and message.segment == segment:
            motion = stretched(message, end_ns)
        self.asked += 1
        self.used += motion is not None
        return motion


def stretched(message: MotionPrediction, end_ns: int) -> Optional[CameraMotion]:
    """The predicted motion up to another end, with constant velocity; None for garbage or an end too far away.

    Its error grows likewise, as that of a velocity does.
    """
    start_ns = stamp_ns_of(message.start)
    predicted_ns, wanted_ns = stamp_ns_of(message.header.stamp) - start_ns, end_ns - start_ns
    if predicted_ns <= 0 or not 0 < wanted_ns <= LONGEST_STRETCH * predicted_ns:
        return None
    try:
        T_start_predicted = matrix_from_pose(message.motion)
    except ValueError:
        return None
    covariance = np.reshape(message.covariance, (6, 6))
    if not np.isfinite(covariance).all():
        return None
    stretch = wanted_ns / predicted_ns
    return CameraMotion(se3.exp(stretch * se3.log(T_start_predicted)), stretch**2 * covariance)
