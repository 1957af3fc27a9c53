# SPDX-License-Identifier: BSD-3-Clause
"""Lets a bag begin when the nodes that use it are ready, and says what they will miss in it."""

from pathlib import Path
from typing import List, Set

import rosgraph
import rospy
from std_srvs.srv import SetBool

from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.errors import InputError, one_line

POLL_S = 0.2
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
OF_WHEELS = ("sensor_msgs/msg/JointState", "std_msgs/msg/Int32", "nav_msgs/msg/Odometry")


class PlaybackGate:
    """Starts a paused `rosbag play`, the node `player`, so that nothing of the bag is missed.

    Parameters:
        ~bag: the bag that is played.
        ~image: topic of the images, or its base name where they are compressed.
        ~wheels: list of the topics of the wheels.
        ~topics: list of further topics that must have subscribers, those between the nodes.
    """

    def __init__(self) -> None:
        """Read the parameters.

        Raises:
            InputError: the bag cannot be read, or has no such images.
        """
        # roslaunch sets the parameters before it starts the nodes; the transport may be an argument or in dso_settings.
        compressed = rospy.get_param("dso_node/image_transport", "raw") == "compressed"
        self._image = rospy.resolve_name(rospy.get_param("~image")) + ("/compressed" if compressed else "")
        self._wheels: List[str] = list(map(rospy.resolve_name, rospy.get_param("~wheels")))
        self._between: List[str] = list(map(rospy.resolve_name, rospy.get_param("~topics")))
        self._check(BagContents(Path(rospy.get_param("~bag"))))

    @property
    def awaited(self) -> Set[str]:
        """Whole names of the topics that must have subscribers."""
        return {self._image, *self._wheels, *self._between}

    def spin(self) -> None:
        """Wait, let go, and stay until the end."""
        rospy.loginfo("the bag begins when %s have subscribers", ", ".join(sorted(self.awaited)))
        master = rosgraph.Master(rospy.get_name())
        while not rospy.is_shutdown():
            _, subscribers, _ = master.getSystemState()
            if self.awaited <= {topic for topic, _ in subscribers}:
                self._let_go()
                rospy.spin()
            rospy.rostime.wallsleep(POLL_S)

    def _check(self, bag: BagContents) -> None:
        """Say what the nodes will miss in the bag.

        Raises:
            InputError: the images.
        """
        if self._image not in bag.types:
            remedy = _remedy("image", bag.of_type(*IMAGES))
            if f"{self._image}/compressed" in bag.types:
                remedy = "its images are compressed: set image_transport:=compressed"
            raise InputError(one_line(f"{bag.path}: {self._image} is not in it; {remedy}"))
        missing = [topic for topic in self._wheels if topic not in bag.types]
        if missing:
            remedy = _remedy("joint_states, left_ticks and right_ticks, or wheel_odometry", bag.of_type(*OF_WHEELS))
            rospy.logwarn(one_line(f"{bag.path}: {' and '.join(missing)} is not in it: no wheels; {remedy}"))

    def _let_go(self) -> None:
        pause = rospy.ServiceProxy("player/pause_playback", SetBool)
        try:
            pause.wait_for_service()
            rospy.rostime.wallsleep(POLL_S)  # the connections themselves are made meanwhile
            pause(False)
        except rospy.ROSException as error:
            if not rospy.is_shutdown():
                raise InputError(f"the bag cannot be started: {error}") from error


def _remedy(argument: str, topics: List[str]) -> str:
    return f"choose with the argument {argument}; it has {', '.join(topics) or 'nothing of the kind'}"
