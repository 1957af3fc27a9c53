# SPDX-License-Identifier: BSD-3-Clause
"""What map_node publishes except tf."""

from typing import Callable, Dict, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from ceiling_dso_ros.dso.mapping.map_snapshot import MapPoints
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.msg import MapStatus
from ceiling_dso_ros.ros.conversions import pose_from_matrix
from ceiling_dso_ros.ros.map_publisher import point_cloud
from ceiling_dso_ros.ros.node import publishing
from ceiling_dso_ros.ros.periodic import Periodic
from ceiling_dso_ros.ros.planar_messages import IN_PLANE, spatial_covariance
from ceiling_dso_ros.slam.deciding import Place
from ceiling_dso_ros.slam.localiser import Localisation
from ceiling_dso_ros.slam.site_map import SiteMap

SHOWN_PERIOD_S = 1.0
POINTS_OF_A_KEYFRAME = 200  # that are shown
LOOP_STEP_M = 0.05  # between the points of which a loop is drawn

# (state of the localisation, map is built, there are hypotheses) -> state in MapStatus
STATES: Dict[Tuple[Localisation, bool, bool], int] = {
    (state, mapping, likely): {
        Localisation.LOCALISED: MapStatus.MAPPING if mapping else MapStatus.LOCALISED,
        Localisation.AMBIGUOUS: MapStatus.AMBIGUOUS,
        Localisation.SEARCHING: MapStatus.LOCALISING if likely else MapStatus.SEARCHING,
    }[state]
    for state in Localisation
    for mapping in (False, True)
    for likely in (False, True)
}


class SitePublisher:
    """The topics of `MapServer` except tf.

    Args:
        map_frame: frame of all of them.
        site: gives the map, None without one; it is asked only when somebody looks.
    """

    def __init__(self, map_frame: str, site: Callable[[], Optional[SiteMap]]) -> None:
        self._map_frame, self._site = map_frame, site
        self._pose = rospy.Publisher("localization/pose", PoseWithCovarianceStamped, queue_size=50)
        self._status = rospy.Publisher("map/status", MapStatus, queue_size=50, latch=True)
        self._hypotheses = rospy.Publisher("map/hypotheses", PoseArray, queue_size=1)
        self._keyframes = rospy.Publisher("map/keyframes", PoseArray, queue_size=1, latch=True)
        self._points = rospy.Publisher("map/points", PointCloud2, queue_size=1, latch=True)
        self._loops = rospy.Publisher("map/loops", PointCloud2, queue_size=1, latch=True)
        self._is_new = True
        Periodic(self._show, SHOWN_PERIOD_S, "map")

    def publish_status(self, status: MapStatus) -> None:
        """Publish a status that is complete."""
        with publishing():
            self._status.publish(status)

    def publish_place(self, stamp: rospy.Time, place: Place) -> None:
        """Publish where the robot is."""
        message = PoseWithCovarianceStamped(header=self._header(stamp))
        message.pose.pose = pose_from_matrix(planar.lift(place.pose))
        covariance = planar.rotate_covariance(place.covariance, place.pose[2])
        message.pose.covariance = spatial_covariance(covariance, IN_PLANE).ravel().tolist()
        self._pose.publish(message)

    def publish_hypotheses(self, stamp: rospy.Time, poses: np.ndarray) -> None:
        """Publish the (N, 3) places that are possible, when somebody listens."""
        if self._hypotheses.get_num_connections() > 0:
            self._hypotheses.publish(self._poses(stamp, poses))

    def changed(self) -> None:
        """The map has changed: it is shown anew soon."""
        self._is_new = True

    def _show(self) -> None:
        wanted = [p for p in (self._keyframes, self._points, self._loops) if p.get_num_connections() > 0]
        site = self._site() if wanted and self._is_new else None
        if site is None:
            return
        self._is_new = False
        stamp = rospy.Time.now()
        with publishing():
            if self._keyframes in wanted:
                self._keyframes.publish(self._poses(stamp, site.poses))
            if self._points in wanted:
                self._points.publish(point_cloud(self._header(stamp), _ceiling(site)))
            if self._loops in wanted:
                self._loops.publish(point_cloud(self._header(stamp), _loops(site)))

    def _poses(self, stamp: rospy.Time, poses: np.ndarray) -> PoseArray:
        return PoseArray(self._header(stamp), [pose_from_matrix(planar.lift(pose)) for pose in poses])

    def _header(self, stamp: rospy.Time) -> Header:
        return Header(stamp=stamp, frame_id=self._map_frame)


def _ceiling(site: SiteMap) -> MapPoints:
    """Some points of each keyframe, in map."""
    parts = [np.zeros((0, 3))]
    for keyframe in site.keyframes:
        points = keyframe.record.points[:: max(1, len(keyframe.record.points) // POINTS_OF_A_KEYFRAME)]
        T = planar.lift(keyframe.pose)
        parts.append(points @ T[:3, :3].T + T[:3, 3])
    positions = np.concatenate(parts)
    return MapPoints(positions, np.zeros(len(positions), np.float32))


def _loops(site: SiteMap) -> MapPoints:
    """Points along a line between the two keyframes of each loop, on the floor."""
    poses, parts = site.poses, [np.zeros((0, 2))]
    for edge in site.edges:
        if edge.is_loop:
            start, end = poses[edge.start, :2], poses[edge.end, :2]
            count = 2 + int(np.hypot(*(end - start)) / LOOP_STEP_M)
            parts.append(np.linspace(start, end, count))
    flat = np.concatenate(parts)
    return MapPoints(np.column_stack([flat, np.zeros(len(flat))]), np.zeros(len(flat), np.float32))
