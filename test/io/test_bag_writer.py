# SPDX-License-Identifier: BSD-3-Clause
import re
import resource
import signal
import struct

import numpy as np
import pytest
from rosbags.rosbag1 import Reader

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import OutputError
from ceiling_dso_ros.io.ros_messages import TYPES, header_stamp_ns, transform_matrix

STAMP_NS = 1_700_000_001_030_042_017

# What `rosmsg md5 TYPE` prints on a ROS Noetic system.
NOETIC_MD5 = {
    "sensor_msgs/msg/Image": "060021388200f6f0f447d0fcd9c64743",
    "sensor_msgs/msg/CompressedImage": "8f7a12909da2c9d3332d540a0977563f",
    "sensor_msgs/msg/CameraInfo": "c9a58c1b0b154e0e6da7578cb991d214",
    "sensor_msgs/msg/JointState": "3066dcd76a6cfaef579bd0f34173e9fd",
    "sensor_msgs/msg/LaserScan": "90c7ef2dc6895d81024acba2ac42f369",
    "sensor_msgs/msg/Imu": "6a62c6daae103f4ff57a132d6f95cec2",
    "std_msgs/msg/Int32": "da5909fbe378aeaf85e547e830cc1bb7",
    "nav_msgs/msg/Odometry": "cd5e73d190d741a2f92e81eda573aca7",
    "geometry_msgs/msg/PoseStamped": "d3812c3cbc69362b77dc0b19b345f8f5",
    "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
}


def a_transform():
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = [0.18, 0.04, 0.62]
    return T


def write_one_of_each(path):
    with BagWriter(path) as bag:
        bag.tf_static(STAMP_NS, [("base_link", "camera", a_transform())])
        bag.image("/image", STAMP_NS, "camera", np.arange(12, dtype=np.uint8).reshape(3, 4))
        bag.compressed_image("/image/compressed", STAMP_NS, "camera", b"\xff\xd8\xff\xd9", "jpeg")
        bag.camera_info("/camera_info", STAMP_NS, "camera", (4, 3), np.diag([5.0, 6.0, 1.0]))
        bag.exposure("/exposure", STAMP_NS, "camera", 5.5)
        bag.ticks("/ticks", STAMP_NS, -7)
        bag.joint_state("/joint_states", STAMP_NS, ["left", "right"], [0.1, 0.2], [1.0, 2.0])
        bag.odometry("/odom", STAMP_NS, "odom", "base_link", a_transform(), [1, 0, 0], [0, 0, 2])
        bag.pose("/pose", STAMP_NS, "odom", a_transform())
        bag.laser_scan("/scan", STAMP_NS, "laser", np.ones(3), (-1.0, 1.0), (0.1, 30.0))
        bag.imu("/imu", STAMP_NS, "imu", [0, 0, 1], [0, 0, 9.81])


def read_all(path):
    with Reader(path) as reader:
        return {
            connection.topic: (connection, stamp_ns, TYPES.deserialize_ros1(data, connection.msgtype))
            for connection, stamp_ns, data in reader.messages()
        }


def test_every_message_comes_back(tmp_path):
    write_one_of_each(tmp_path / "a.bag")
    messages = read_all(tmp_path / "a.bag")

    assert len(messages) == 11
    for topic, (_, stamp_ns, content) in messages.items():
        assert stamp_ns == STAMP_NS
        if hasattr(content, "header"):
            assert header_stamp_ns(content.header) == STAMP_NS, topic
    image = messages["/image"][2]
    assert (image.height, image.width, image.step, image.encoding) == (3, 4, 4, "mono8")
    assert image.data.tolist() == list(range(12))
    assert messages["/exposure"][2].exposure_ms == 5.5
    assert messages["/ticks"][2].data == -7
    assert messages["/odom"][2].twist.twist.angular.z == 2.0
    scan = messages["/scan"][2]
    assert scan.angle_min + scan.angle_increment * 2 == scan.angle_max
    connection, _, static = messages["/tf_static"]
    parent, child, T = transform_matrix(static.transforms[0])
    assert (parent, child) == ("base_link", "camera")
    np.testing.assert_allclose(T, a_transform(), atol=1e-15)
    assert connection.ext.latching == 1, "rosbag play latches what was latched"


def test_types_have_the_checksums_of_ros(tmp_path):
    write_one_of_each(tmp_path / "a.bag")
    for connection, _, _ in read_all(tmp_path / "a.bag").values():
        if connection.msgtype in NOETIC_MD5:
            assert connection.digest == NOETIC_MD5[connection.msgtype], connection.msgtype


def test_sixteen_bit_and_colour_images(tmp_path):
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) * 1000
    colour = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image("/depth", STAMP_NS, "camera", depth)
        bag.image("/colour", STAMP_NS, "camera", colour, "rgb8")
    messages = read_all(tmp_path / "a.bag")
    assert (messages["/depth"][2].encoding, messages["/depth"][2].step) == ("mono16", 8)
    assert messages["/depth"][2].data.view(np.uint16).tolist() == depth.ravel().tolist()
    assert (messages["/colour"][2].encoding, messages["/colour"][2].step) == ("rgb8", 12)


def test_the_first_record_is_as_long_as_ros_makes_it(tmp_path):
    """`rosbag reindex` and appending replace it by one of 4096 bytes, besides the lengths of its header and data."""

    def check(path):
        content = path.read_bytes()[len(b"#ROSBAG V2.0\n") :]
        (header_length,) = struct.unpack_from("<L", content)
        (data_length,) = struct.unpack_from("<L", content, 4 + header_length)
        assert header_length + data_length == 4096
        next_record = content[4 + 4 + 4096 :]
        assert b"op=\x05" in next_record[:50], "a chunk follows"

    with BagWriter(tmp_path / "a.bag") as bag:
        bag.image("/image", STAMP_NS, "camera", np.zeros((2000, 1000), np.uint8))
        bag._writer.bio.flush()
        check(tmp_path / "a.bag.active")
    check(tmp_path / "a.bag")


def test_same_calls_give_the_same_bytes(tmp_path):
    write_one_of_each(tmp_path / "a.bag")
    write_one_of_each(tmp_path / "b.bag")
    assert (tmp_path / "a.bag").read_bytes() == (tmp_path / "b.bag").read_bytes()


def test_an_interrupted_bag_is_readable(tmp_path):
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "a.bag") as bag:
        bag.ticks("/ticks", STAMP_NS, 1)
        raise KeyboardInterrupt
    assert read_all(tmp_path / "a.bag")["/ticks"][2].data == 1
    assert [path.name for path in tmp_path.iterdir()] == ["a.bag"]


def test_an_interrupt_amid_a_message_leaves_a_readable_bag(tmp_path, monkeypatch, interruptible):
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "a.bag") as bag:
        write_chunk = bag._writer.write_chunk

        def interrupted(chunk):
            signal.raise_signal(signal.SIGINT)
            write_chunk(chunk)

        monkeypatch.setattr(bag._writer, "write_chunk", interrupted)
        for i in range(5):
            bag.image("/image", STAMP_NS + i, "camera", np.zeros((1000, 1000), np.uint8))
    with Reader(tmp_path / "a.bag") as reader:
        assert 0 < len([TYPES.deserialize_ros1(data, c.msgtype) for c, _, data in reader.messages()]) < 5


def test_an_older_bag_is_replaced(tmp_path):
    for value in (1, 2):
        with BagWriter(tmp_path / "a.bag") as bag:
            bag.ticks("/ticks", STAMP_NS, value)
    assert read_all(tmp_path / "a.bag")["/ticks"][2].data == 2


def test_a_folder_that_is_not_there(tmp_path):
    path = tmp_path / "missing" / "a.bag"
    with pytest.raises(OutputError, match=re.escape(f"{path}: cannot write the bag: No such file or directory")):
        BagWriter(path)


@pytest.fixture
def two_megabytes():
    """No file may grow beyond that, as if the disk were full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_full_disk_while_writing_or_closing(tmp_path, two_megabytes, count):
    path = tmp_path / "a.bag"
    expected = re.escape(f"{path}: cannot write the bag, it was removed: File too large")
    with pytest.raises(OutputError, match=expected), BagWriter(path) as bag:
        for i in range(count):
            bag.image("/image", STAMP_NS + i, "camera", np.zeros((1000, 2100), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_a_failure_to_write_another_file_leaves_a_readable_bag(tmp_path):
    with pytest.raises(OutputError), BagWriter(tmp_path / "a.bag") as bag:
        bag.ticks("/ticks", STAMP_NS, 1)
        raise OutputError("b.tum: cannot write the trajectory")
    assert read_all(tmp_path / "a.bag")["/ticks"][2].data == 1
