"""How the camera has moved since the last image by the wheels, as fusion_node says it."""

from typing import Optional

import numpy as np
import rospy

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.io.stamps import seconds
from ceiling_dso_ros.msg import MotionPrediction
from ceiling_dso_ros.ros.conversions import matrix_from_pose

LONGEST_STRETCH = 3.0  # a prediction is taken to go on like that for so many times its own length


class MotionPredictions:
    """Listens to `fusion/motion_prediction`; the newest one counts."""

    def __init__(self) -> None:
        self._newest: Optional[MotionPrediction] = None
        rospy.Subscriber("fusion/motion_prediction", MotionPrediction, self.add, queue_size=10, tcp_nodelay=True)

    def add(self, message: MotionPrediction) -> None:
        """Take in a message."""
        self._newest = message

    def between(self, start: rospy.Time, end: rospy.Time, segment: int) -> Optional[CameraMotion]:
        """Motion of the camera between two images, in the unit of a segment; None when nothing is known."""
        message = self._newest
        if message is None or message.start != start or message.segment != segment:
            return None
        return stretched(message, seconds(end.to_nsec()))


def stretched(message: MotionPrediction, end_s: float) -> Optional[CameraMotion]:
    """The predicted motion up to another end, with constant velocity; None for garbage or an end too far away.

    Its error grows likewise, as that of a velocity does.
    """
    start_s, predicted_s = seconds(message.start.to_nsec()), seconds(message.header.stamp.to_nsec())
    if not start_s < predicted_s or not 0.0 < end_s - start_s <= LONGEST_STRETCH * (predicted_s - start_s):
        return None
    try:
        T_start_predicted = matrix_from_pose(message.motion)
    except ValueError:
        return None
    covariance = np.reshape(message.covariance, (6, 6))
    if not np.isfinite(covariance).all():
        return None
    stretch = (end_s - start_s) / (predicted_s - start_s)
    return CameraMotion(se3.exp(stretch * se3.log(T_start_predicted)), stretch**2 * covariance)
