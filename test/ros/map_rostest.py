#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""map_node: a map is built, saved, loaded, and the robot found in it; what is said live is what comes out offline."""

import contextlib
import sys
import tempfile
import time
import unittest
import xmlrpc.client
from pathlib import Path

import numpy as np
import painted_ceiling as ceiling
import rosgraph
import rospy
import rostest
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_srvs.srv import Empty, SetBool
from tf2_msgs.msg import TFMessage
from told_drive import Teller, ToldDrive
from waiting import wait_until

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.ros_messages import planar_pose
from ceiling_dso_ros.msg import KeyframeView, LeftKeyframe, MapStatus
from ceiling_dso_ros.slam.record_maker import RecordMaker
from ceiling_dso_ros.slam.session import MapSession
from ceiling_dso_ros.srv import LoadMap, SaveMap

TEXTURE = ceiling.paint(10)
TRUE = ceiling.round_trip(1.6, 1.2, 18)
BACK = ceiling.round_trip(1.6, 0.45, 18, sense=-1.0)


class Listener:
    def __init__(self):
        self.statuses, self.poses, self.transforms = [], {}, []
        rospy.Subscriber("map/status", MapStatus, self.statuses.append)
        rospy.Subscriber("localization/pose", PoseWithCovarianceStamped, self._on_pose)
        rospy.Subscriber("/tf", TFMessage, lambda message: self.transforms.extend(message.transforms))

    def _on_pose(self, message):
        self.poses[message.header.stamp.to_nsec()] = message

    def status_at(self, stamp_ns):
        return next((s for s in reversed(self.statuses) if s.header.stamp.to_nsec() == stamp_ns), None)


class Map(unittest.TestCase):
    """The tests are parts of one operation, in the order of their names."""

    @classmethod
    def setUpClass(cls):
        cls.teller, cls.heard = Teller(), Listener()
        cls.folder = tempfile.TemporaryDirectory()
        cls.file = Path(cls.folder.name) / "hall.site"
        cls.first = ToldDrive(TEXTURE, TRUE, ceiling.drifted(TRUE, seed=5), 1_000_000_000_000)
        wait_until(lambda: cls.teller.is_heard and cls.heard.statuses)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def tell(self, drive, until=lambda status: False):
        """Tell of a drive, keyframe by keyframe; returns the last status."""
        for i in range(len(drive)):
            self.teller.tell(drive, i)
            wait_until(lambda stamp_ns=drive.newest_ns(i): self.heard.status_at(stamp_ns))
            status = self.heard.status_at(drive.newest_ns(i))
            if until(status):
                break
        return status

    def pose(self, drive, i):
        """(3,) in map, and its message."""
        wait_until(lambda: drive.newest_ns(i) in self.heard.poses)
        message = self.heard.poses[drive.newest_ns(i)]
        return planar_pose(message.pose.pose), message

    def call(self, name, kind, *arguments):
        rospy.wait_for_service(name, 60.0)
        return rospy.ServiceProxy(name, kind)(*arguments)

    def load(self):
        answer = self.call("map_node/load_map", LoadMap, str(self.file))
        self.assertTrue(answer.success, answer.message)

    def test_1_a_map_is_built_as_offline(self):
        self.assertEqual(self.heard.statuses[-1].state, MapStatus.SEARCHING)  # the file that was named is not there
        self.assertEqual(self.tell(self.first).state, MapStatus.MAPPING)
        maker, session = RecordMaker(), MapSession(ceiling.RECORD_CAMERA)
        for i in range(len(self.first)):
            maker.add_view(self.first.view(i))
            maker.add_pose(self.first.left(i))
            for new in maker.take(ceiling.RECORD_CAMERA.T_base_camera):
                place = session.add(new).place
                self.assertLess(np.hypot(*(self.pose(self.first, i)[0] - place.pose)[:2]), 1e-3)
        status = self.heard.statuses[-1]
        self.assertEqual(status.keyframes, len(session.site.keyframes))
        self.assertGreater(status.loops, 0)

    def test_2_the_transform_takes_the_odometry_to_the_map_and_is_ahead(self):
        last = len(self.first) - 1
        pose, message = self.pose(self.first, last)
        self.assertEqual(message.header.frame_id, "map")
        self.assertTrue(np.all(np.diag(np.reshape(message.pose.covariance, (6, 6))) > 0.0))

        def sent():
            return [t for t in list(self.heard.transforms) if t.child_frame_id == "odom"]

        def leads_there():
            own = sent()[-1].transform
            yaw = 2.0 * np.arctan2(own.rotation.z, own.rotation.w)
            T_map_odom = np.array([own.translation.x, own.translation.y, yaw])
            found = planar.compose(T_map_odom, self.first.newest(last)[1])
            return np.abs(planar.between(pose, found)).max() < 1e-6

        wait_until(lambda: sent() and leads_there())
        ahead_ns = sent()[-1].header.stamp.to_nsec() - self.first.newest_ns(last)
        self.assertGreaterEqual(ahead_ns, 100_000_000)
        count = len(sent())
        wait_until(lambda: len(sent()) > count + 2)  # without anything new

    def test_3_it_is_saved_and_the_same_map_gives_the_same_bytes(self):
        answer = self.call("map_node/save_map", SaveMap, str(self.file))
        self.assertTrue(answer.success, answer.message)
        content = self.file.read_bytes()
        self.load()
        self.assertTrue(self.call("map_node/save_map", SaveMap, "").success)
        self.assertEqual(self.file.read_bytes(), content)
        self.assertFalse(self.call("map_node/save_map", SaveMap, "/proc/no.site").success)

    def test_4_a_bad_map_and_bad_messages_change_nothing(self):
        damaged = self.file.with_name("damaged.site")
        damaged.write_bytes(self.file.read_bytes()[:1000])
        answer = self.call("map_node/load_map", LoadMap, str(damaged))
        self.assertFalse(answer.success)
        self.assertIn("damaged.site", answer.message)
        self.assertNotIn("\n", answer.message)
        self.teller.views.publish(KeyframeView(width=100, height=100, grey=b"1"))
        self.teller.left.publish(LeftKeyframe(metres_per_unit=np.nan))

    def test_5_the_robot_is_found_again_and_noticed_when_it_is_carried_away(self):
        self.call("map_node/pause_mapping", SetBool, True)
        odom = ceiling.drifted(BACK, start=(7.0, -3.0, 1.0))
        drive = ToldDrive(TEXTURE, BACK, odom, 2_000_000_000_000, seed=9)
        status = self.tell(drive, lambda status: status.state == MapStatus.LOCALISED)
        self.assertEqual(status.state, MapStatus.LOCALISED, status.why)
        self.assertGreaterEqual(status.rejected, 2)  # of the test before
        i = next(i for i in range(len(drive)) if drive.newest_ns(i) == status.header.stamp.to_nsec())
        error = planar.between(planar.between(TRUE[0], drive.newest(i)[0]), self.pose(drive, i)[0])
        self.assertLess(np.hypot(*error[:2]), 0.1)

        elsewhere = ToldDrive(ceiling.paint(77), BACK, ceiling.drifted(BACK), 3_000_000_000_000)
        status = self.tell(elsewhere)
        self.assertNotEqual(status.state, MapStatus.LOCALISED)
        self.assertNotIn(status.header.stamp.to_nsec(), self.heard.poses)

    def test_6_who_says_where_the_robot_is_shortens_the_search(self):
        drive = ToldDrive(TEXTURE, BACK, ceiling.drifted(BACK), 4_000_000_000_000, seed=11)
        self.tell(drive, lambda _: True)
        message = PoseWithCovarianceStamped()
        message.header.frame_id = "map"
        place = np.add(planar.between(TRUE[0], BACK[0]), (0.2, -0.1, 0.05))
        message.pose.pose.position.x, message.pose.pose.position.y = place[:2]
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = np.sin(place[2] / 2), np.cos(place[2] / 2)
        message.pose.covariance = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.07]).ravel().tolist()
        told = rospy.Publisher("initialpose", PoseWithCovarianceStamped, queue_size=1)
        wait_until(lambda: told.get_num_connections())
        count = len(self.heard.statuses)
        told.publish(message)
        wait_until(lambda: len(self.heard.statuses) > count)
        for i in (1, 2, 3):
            self.teller.tell(drive, i)
            wait_until(lambda stamp_ns=drive.newest_ns(i): self.heard.status_at(stamp_ns))
        self.assertEqual(self.heard.status_at(drive.newest_ns(3)).state, MapStatus.LOCALISED)
        self.call("global_localization", Empty)
        wait_until(lambda: self.heard.statuses[-1].state == MapStatus.SEARCHING)

    def test_7_a_restarted_node_finds_the_robot_in_the_file(self):
        master, count = rosgraph.Master(rospy.get_name()), len(self.heard.statuses)
        before = master.lookupService("/map_node/load_map")
        with contextlib.suppress(OSError):  # it may end before it answers
            xmlrpc.client.ServerProxy(master.lookupNode("/map_node")).shutdown(rospy.get_name(), "restart")

        def is_back():
            try:
                return master.lookupService("/map_node/load_map") != before
            except rosgraph.MasterException:
                return False

        wait_until(lambda: is_back() and len(self.heard.statuses) > count)
        time.sleep(2.0)  # until the topics are connected: the lost connections count until something is sent
        self.load()
        drive = ToldDrive(TEXTURE, BACK, ceiling.drifted(BACK), 5_000_000_000_000, seed=12)
        status = self.tell(drive, lambda status: status.state == MapStatus.MAPPING)
        self.assertEqual(status.state, MapStatus.MAPPING, status.why)


if __name__ == "__main__":
    rospy.init_node("map_rostest")
    rostest.rosrun("ceiling_dso_ros", "map", Map, sys.argv)
