# SPDX-License-Identifier: BSD-3-Clause
"""A drive below a painted ceiling as dso_node and fusion_node tell map_node of it."""

import numpy as np
import painted_ceiling as ceiling
import rospy
from geometry_msgs.msg import Pose2D
from nav_msgs.msg import Odometry
from std_msgs.msg import Header

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.leaving import LeavingKeyframe
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.msg import KeyframeView, LeftKeyframe
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time
from ceiling_dso_ros.ros.keyframe_messages import view_message
from ceiling_dso_ros.slam import records

STEP_NS = 500_000_000
COVARIANCE = np.diag(ceiling.STEP_SIGMAS**2)
TO_NEWEST = np.array([0.05, 0.0, 0.01])  # the keyframe that leaves is not the newest one
NEWEST_NS = 100_000_000


class ToldDrive:
    """Keyframes of a drive whose odometry begins anew: nothing is known of the motion from the drive before."""

    def __init__(self, texture, true, odom, begin_ns, seed=0):
        self._texture, self._true, self._odom, self._begin_ns, self._seed = texture, true, odom, begin_ns, seed

    def __len__(self):
        return len(self._true)

    def stamp_ns(self, i):
        return self._begin_ns + i * STEP_NS

    def newest_ns(self, i):
        return self.stamp_ns(i) + NEWEST_NS

    def newest(self, i):
        """(3,) true pose at the newest keyframe, and that by the odometry."""
        return tuple(planar.compose(poses[i], TO_NEWEST) for poses in (self._true, self._odom))

    def tilt(self, i):
        """The robot shakes, and its fusion knows by how much."""
        leans = 2e-3 * np.random.default_rng([self._seed, i, 1]).normal(size=2)
        return Tilt(leans, np.array([1e-3, 5e-4]))

    def view(self, i):
        image, points = ceiling.seen(self._texture, self._true[i], i, self._seed, leans=self.tilt(i).angles)
        return records.KeyframeView.of(self.stamp_ns(i), i, image, ceiling.CAMERA, points)

    def left(self, i):
        before_ns = self.stamp_ns(i - 1) if i else None
        motion = planar.between(self._odom[i - 1], self._odom[i]) if i else np.zeros(3)
        covariance = COVARIANCE if i else np.zeros((3, 3))
        stamps_ns = self.stamp_ns(i), before_ns
        newest = self.newest_ns(i), TO_NEWEST
        return LeavingKeyframe(i, *stamps_ns, self._odom[i], motion, covariance, 1.0, *newest, self.tilt(i))


class Teller:
    """Publishes drives."""

    def __init__(self):
        self._odometry = rospy.Publisher("odometry/filtered", Odometry, queue_size=100)
        self.views = rospy.Publisher("visual_odometry/views", KeyframeView, queue_size=100)
        self.left = rospy.Publisher("fusion/left_keyframes", LeftKeyframe, queue_size=100)

    @property
    def is_heard(self):
        return all(topic.get_num_connections() > 0 for topic in (self._odometry, self.views, self.left))

    def tell(self, drive, i):
        odometry = Odometry(header=Header(stamp=ros_time(drive.newest_ns(i)), frame_id="odom"))
        odometry.pose.pose = pose_from_matrix(planar.lift(drive.newest(i)[1]))
        self._odometry.publish(odometry)
        self.views.publish(view_message(drive.view(i), drive.stamp_ns(i), "camera"))
        self.left.publish(left_message(drive.left(i)))


def left_message(left):
    """As fusion_node makes it."""
    return LeftKeyframe(
        header=Header(stamp=ros_time(left.image_ns), frame_id="odom"),
        id=left.keyframe_id,
        pose=Pose2D(*left.pose),
        before=ros_time(left.before_ns or 0),
        motion=Pose2D(*left.motion),
        covariance=left.covariance.ravel().tolist(),
        metres_per_unit=left.metres_per_unit,
        newest=ros_time(left.newest_ns),
        to_newest=Pose2D(*left.to_newest),
        tilt=left.tilt.angles.tolist(),
        tilt_sigma=left.tilt.sigmas.tolist(),
        mount=pose_from_matrix(ceiling.RECORD_CAMERA.T_base_camera),
    )
