# SPDX-License-Identifier: BSD-3-Clause
"""The scans of a bag: sensor_msgs/LaserScan, or the first echoes of sensor_msgs/MultiEchoLaserScan."""

from typing import Callable, Optional

import numpy as np

from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.bag_reader import read_messages
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.laser_scans import LaserScans, ScanCollector, ScanGeometry
from ceiling_dso_ros.io.ros_messages import RosMessage, header_stamp_ns

LASER_SCAN, MULTI_ECHO = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan"
USUAL_TOPIC = "/scan"


def read_bag_scans(
    bag: BagContents,
    topic: Optional[str],
    base_frame: str,
    laser_frame: Optional[str],
    mount: Optional[np.ndarray],
    warn: Callable[[str], None],
) -> LaserScans:
    """Read all scans of a topic.

    Args:
        bag: where they are.
        topic: their topic; None for /scan, or the only one that has scans.
        base_frame: frame of the robot.
        laser_frame: frame of the laser; None for that of the scans.
        mount: T_base_laser (4, 4); None for that of tf.
        warn: is told what is not used.

    Raises:
        InputError: there are no scans that can be used, or tf does not have the mount.
    """
    topic = _find_topic(bag, topic)
    collector = ScanCollector(f"{bag.path}, {topic}", warn)
    frame = laser_frame
    for raw in read_messages(bag.path, [topic]):
        try:
            scan = raw.content()
        except FrameError as error:
            collector.unused[str(error)] += 1
            continue
        frame = frame or str(scan.header.frame_id).strip("/") or None
        geometry = ScanGeometry(float(scan.angle_min), float(scan.angle_increment), float(scan.time_increment))
        limits = np.array([scan.range_min, scan.range_max], np.float64)
        collector.add(header_stamp_ns(scan.header), _first_echoes(scan, raw.message_type), geometry, limits)
    return collector.scans(mount if mount is not None else _find_mount(bag, topic, base_frame, frame))


def _find_topic(bag: BagContents, topic: Optional[str]) -> str:
    topics = bag.of_type(LASER_SCAN, MULTI_ECHO)
    known = ", ".join(topics) or "none"
    if topic is not None:
        if topic not in topics:
            raise InputError(f"{bag.path}: no scans on {topic}; its topics with scans: {known}")
        return topic
    if not topics:
        raise InputError(
            f"{bag.path}: has no scans; record sensor_msgs/LaserScan of the robot's LiDAR, as with rosbag record /scan"
        )
    if USUAL_TOPIC not in topics and len(topics) > 1:
        raise InputError(f"{bag.path}: has several topics with scans, {known}; choose one with --scan-topic")
    return USUAL_TOPIC if USUAL_TOPIC in topics else topics[0]


def _first_echoes(scan: RosMessage, message_type: str) -> np.ndarray:
    """(R,) ranges, NaN where there is no echo."""
    if message_type == LASER_SCAN:
        return np.asarray(scan.ranges)
    return np.array([ray.echoes[0] if len(ray.echoes) else np.nan for ray in scan.ranges], np.float32)


def _find_mount(bag: BagContents, topic: str, base_frame: str, laser_frame: Optional[str]) -> np.ndarray:
    remedy = "name the frames with --base-frame and --laser-frame, or give the mount with --laser-mount X Y YAW"
    if laser_frame is None:
        raise InputError(f"{bag.path}: the scans on {topic} do not name their frame; {remedy}")
    mount, frames = bag.find_transform(base_frame, laser_frame)
    if mount is None:
        raise InputError(
            f"{bag.path}: tf has no {base_frame} -> {laser_frame}, its frames are {', '.join(frames) or 'none'}; "
            f"{remedy}"
        )
    return mount
