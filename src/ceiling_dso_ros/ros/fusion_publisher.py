# SPDX-License-Identifier: BSD-3-Clause
"""What fusion_node publishes."""

from typing import Optional

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from ceiling_dso_ros.cfg import FusionConfig
from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.fusion.state import FusedState, FusionState, ScaleState
from ceiling_dso_ros.msg import FusionScale, FusionStatus, LeftKeyframe, MotionPrediction
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time
from ceiling_dso_ros.ros.paths import PathPublisher
from ceiling_dso_ros.ros.planar_messages import planar_odometry

PATH_SPACING_M = 0.05  # about a pixel where rviz shows a hall

STATES = {
    FusionState.NOT_SCALED: FusionStatus.NOT_SCALED,
    FusionState.CONVERGED: FusionStatus.CONVERGED,
    FusionState.DEGRADED: FusionStatus.DEGRADED,
}


class FusionPublisher:
    """The topics of `FusionServer` except tf.

    Attributes:
        visual_frame: the world of the visual odometry, as its messages name it.
    """

    def __init__(self, odom_frame: str, base_frame: str) -> None:
        self.visual_frame = ""
        self._covariance_scale = 1.0
        self._odom_frame, self._base_frame = odom_frame, base_frame
        self._odometry = rospy.Publisher("odometry/filtered", Odometry, queue_size=50, tcp_nodelay=True)
        self._scale = rospy.Publisher("fusion/scale", FusionScale, queue_size=50)
        self._status = rospy.Publisher("fusion/status", FusionStatus, queue_size=50)
        self._left = rospy.Publisher("fusion/left_keyframes", LeftKeyframe, queue_size=50)
        self._path = PathPublisher("fusion/path", spacing=PATH_SPACING_M)
        self._prediction = rospy.Publisher(
            "fusion/motion_prediction", MotionPrediction, queue_size=10, tcp_nodelay=True
        )

    def reset(self) -> None:
        """Forget the poses so far."""
        self._path.clear()

    def reconfigure(self, settings: FusionConfig, _level: int) -> FusionConfig:
        """Take in what cfg/Fusion.cfg has."""
        self._covariance_scale = settings.covariance_scale
        self._path.length, self._path.period_s = settings.path_length, settings.path_period
        return settings

    @property
    def prediction_wanted(self) -> bool:
        """Whether somebody listens to the motion prediction."""
        return self._prediction.get_num_connections() > 0

    def publish(self, stamp: rospy.Time, state: FusedState, status: FusionStatus) -> None:
        """Publish an output with the stamp of its data; status is complete but for header, state and reasons."""
        header = Header(stamp=stamp, frame_id=self._odom_frame)
        scale = self._covariance_scale
        odometry = planar_odometry(
            header, self._base_frame, state.pose, scale * state.covariance, state.twist, scale * state.twist_covariance
        )
        self._odometry.publish(odometry)
        self._scale.publish(scale_message(Header(stamp=header.stamp, frame_id=self.visual_frame), state.scale))
        status.header, status.state, status.reasons = header, STATES[state.state], list(state.reasons)
        self._status.publish(status)
        self._path.add(PoseStamped(header, odometry.pose.pose))

    def publish_left(self, message: LeftKeyframe) -> None:
        """Publish a keyframe that has left the window, if somebody listens; all but its frame is set."""
        if self._left.get_num_connections() > 0:
            message.header.frame_id = self._odom_frame
            self._left.publish(message)

    def publish_prediction(self, motion: Optional[CameraMotion], start_ns: int, end_ns: int, segment: int) -> None:
        """Publish the predicted motion of the camera between two of its stamps, if it is known."""
        if motion is None:
            return
        header = Header(stamp=ros_time(end_ns), frame_id=self.visual_frame)
        self._prediction.publish(prediction_message(header, start_ns, motion, segment))


def scale_message(header: Header, scale: ScaleState) -> FusionScale:
    """FusionScale of the scale's estimate."""
    return FusionScale(header, scale.value, scale.sigma, scale.converged, scale.segment)


def prediction_message(header: Header, start_ns: int, motion: CameraMotion, segment: int) -> MotionPrediction:
    """MotionPrediction of the camera's motion from a stamp of its clock to that of the header."""
    return MotionPrediction(
        header=header,
        start=ros_time(start_ns),
        motion=pose_from_matrix(motion.T_start_end),
        covariance=motion.covariance.ravel().tolist(),
        segment=segment,
        normal=[0.0] * 3 if motion.normal is None else motion.normal.tolist(),
        metric=motion.metric,
    )
