# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.bag_scans import read_bag_scans
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.ros_messages import header, message

STAMP_NS = 1_700_000_000_000_000_000


def mount():
    T = np.eye(4)
    T[:3, 3] = 0.28, 0.0, 0.21
    return T


def write(path, topics=("/scan",), frame="laser", with_tf=True, limits=(-1.0, 1.0)):
    with BagWriter(path) as bag:
        if with_tf:
            bag.tf_static(STAMP_NS, [("base_link", "laser", mount())])
        for number in range(3):
            for topic in topics:
                ranges = np.array([1.0, np.inf, 2.0 + number])
                bag.laser_scan(topic, STAMP_NS + number * 10**8, frame, ranges, limits, (0.1, 30.0), 0.1, 1e-3)
    return path


def read(path, topic=None, laser_frame=None, given=None, base="base_link"):
    said = []
    return read_bag_scans(BagContents(path), topic, base, laser_frame, given, said.append), said


def test_scans_are_read_with_their_mount(tmp_path):
    scans, said = read(write(tmp_path / "a.bag"))
    assert scans.stamps_ns.tolist() == [STAMP_NS, STAMP_NS + 10**8, STAMP_NS + 2 * 10**8]
    np.testing.assert_allclose(scans.ranges_m[:, 2], [2.0, 3.0, 4.0])
    assert np.isnan(scans.ranges_m[:, 1]).all()
    np.testing.assert_allclose(scans.geometry[0], [-1.0, 1.0, 1e-3], atol=1e-6)
    np.testing.assert_allclose(scans.T_base_laser, mount())
    assert said == []


def test_an_increment_may_be_negative(tmp_path):
    scans, _ = read(write(tmp_path / "a.bag", limits=(1.0, -1.0)))
    np.testing.assert_allclose(scans.geometry[0, :2], [1.0, -1.0], atol=1e-6)


def test_of_several_topics_scan_is_taken_or_one_must_be_chosen(tmp_path):
    assert read(write(tmp_path / "a.bag", ("/rear", "/scan")))[0].source.endswith("/scan")
    both = write(tmp_path / "b.bag", ("/rear", "/front"))
    with pytest.raises(InputError, match="several topics with scans, /front, /rear; choose one with --scan-topic"):
        read(both)
    assert read(both, "/rear")[0].source.endswith("/rear")
    assert read(write(tmp_path / "c.bag", ("/only",)))[0].source.endswith("/only")
    with pytest.raises(InputError, match="no scans on /other; its topics with scans: /only"):
        read(tmp_path / "c.bag", "/other")


def test_a_bag_without_scans_says_what_to_record(tmp_path):
    with pytest.raises(InputError, match="has no scans; record sensor_msgs/LaserScan"):
        read(write(tmp_path / "a.bag", ()))


def test_a_mount_that_is_not_in_tf_is_asked_for(tmp_path):
    path = write(tmp_path / "a.bag", with_tf=False)
    with pytest.raises(InputError, match="tf has no base_link -> laser, its frames are none; name the frames with"):
        read(path)
    given = np.diag([1.0, -1.0, -1.0, 1.0])
    np.testing.assert_allclose(read(path, given=given)[0].T_base_laser, given)
    with pytest.raises(InputError, match="do not name their frame"):
        read(write(tmp_path / "b.bag", frame=""))
    np.testing.assert_allclose(read(tmp_path / "b.bag", laser_frame="laser")[0].T_base_laser, mount())


def test_of_several_echoes_the_first_counts(tmp_path):
    echoes = [[1.5, 4.0], [], [2.5]]
    content = message(
        "sensor_msgs/MultiEchoLaserScan",
        header=header(STAMP_NS, "laser"),
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=1.0,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=30.0,
        ranges=[message("sensor_msgs/LaserEcho", echoes=np.array(ray, np.float32)) for ray in echoes],
        intensities=[],
    )
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.tf_static(STAMP_NS, [("base_link", "laser", mount())])
        bag.write("/scan", STAMP_NS, content)
    np.testing.assert_allclose(read(tmp_path / "a.bag")[0].ranges_m, [[1.5, np.nan, 2.5]])
