# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Reader

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import OutputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.ros_messages import TYPES, header_stamp_ns, transform_matrix
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.simulation.bag import files_beside, write_files_beside, write_measurements
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

CAMERA = CameraModel(width=104, height=64)
EVERYTHING = {"stereo": True, "forward": True, "imu": True}


def simulated(**settings):
    return SimulatedRecording(
        SimulationConfig("square", "plaster", **{"camera": CAMERA, "duration_s": 3.0, **settings})
    )


def write(path, recording):
    write_files_beside(path, recording)
    with BagWriter(path) as bag:
        write_measurements(bag, recording, recording.simulation.measurements())
    return path


def read(path):
    """Topic -> list of (record stamp, message)."""
    messages = {}
    with Reader(path) as reader:
        for connection, stamp_ns, data in reader.messages():
            content = TYPES.deserialize_ros1(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((stamp_ns, content))
    return messages


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    recording = simulated(**EVERYTHING)
    path = write(tmp_path_factory.mktemp("bag") / "drive.bag", recording)
    return recording, path, read(path)


def test_all_topics_are_there_at_their_rates(bag):
    recording, _, messages = bag
    images, wheels = len(recording), len(recording.simulation.encoders.time_s)
    expected = {"/tf_static": 1, "/scan": 30, "/imu": 598}
    for camera in ("up", "up_right", "front"):
        expected.update({f"/camera/{camera}/{name}": images for name in ("image_raw", "camera_info", "exposure")})
    for topic in ("/joint_states", "/wheel/left/ticks", "/wheel/right/ticks", "/odom", "/ground_truth"):
        expected[topic] = wheels
    counts = {topic: len(content) for topic, content in messages.items()}
    assert counts == pytest.approx(expected, abs=2)
    assert set(counts) == set(expected)


def test_only_what_is_fitted_is_in_the_bag(tmp_path):
    messages = read(write(tmp_path / "plain.bag", simulated(duration_s=0.5)))
    assert not [topic for topic in messages if topic.startswith(("/camera/up_right", "/camera/front", "/imu"))]
    children = {transform.child_frame_id for transform in messages["/tf_static"][0][1].transforms}
    assert children == {"odom", "camera_up_optical_frame", "laser"}


def test_a_sweep_takes_three_quarters_of_a_turn(bag):
    _, _, messages = bag
    _, scan = messages["/scan"][5]
    assert (scan.scan_time, len(scan.ranges)) == (pytest.approx(0.1), 541)
    assert 540 * scan.time_increment == pytest.approx(0.075)
    assert scan.angle_min + 540 * scan.angle_increment == pytest.approx(scan.angle_max)


def test_stamps_are_those_of_the_records_and_grow(bag):
    _, _, messages = bag
    for topic, content in messages.items():
        stamps = [stamp_ns for stamp_ns, _ in content]
        assert stamps == sorted(stamps)
        if topic not in ("/tf_static", "/wheel/left/ticks", "/wheel/right/ticks"):
            assert stamps == [header_stamp_ns(message.header) for _, message in content]


def test_frames_hang_together(bag):
    recording, _, messages = bag
    transforms = [transform_matrix(transform) for transform in messages["/tf_static"][0][1].transforms]
    tree = {child: (parent, T) for parent, child, T in transforms}
    for topic in ("/camera/up/image_raw", "/camera/front/image_raw", "/scan", "/imu"):
        assert tree[messages[topic][0][1].header.frame_id][0] == "base_link"
    np.testing.assert_allclose(tree["camera_up_optical_frame"][1], recording.robot.T_base_camera, atol=1e-9)
    odom = messages["/odom"][0][1]
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert tree["odom"][0] == messages["/ground_truth"][0][1].header.frame_id == "map"


def test_odom_starts_where_the_truth_is_and_drifts(bag):
    recording, _, messages = bag
    _, T_map_odom = next(
        (parent, T)
        for parent, child, T in map(transform_matrix, messages["/tf_static"][0][1].transforms)
        if child == "odom"
    )
    odom, truth = messages["/odom"][-1][1], messages["/ground_truth"][-1][1].pose.position
    position = odom.pose.pose.position
    x, y, _ = (T_map_odom @ [position.x, position.y, position.z, 1.0])[:3]
    assert np.hypot(x - truth.x, y - truth.y) < 0.2
    speed, _ = recording.simulation.robot.motion.rates(recording.simulation.encoders.time_s[-1:])[0]
    assert odom.twist.twist.linear.x == pytest.approx(speed, rel=0.05)
    covariance = np.array(odom.pose.covariance).reshape(6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_the_package_reads_its_own_bag(bag):
    recording, path, _ = bag
    files = files_beside(path)
    again = open_recording(path, robot_file=files["robot"])
    assert len(again) == len(recording)
    for one, two in zip(again.frames(), recording.frames()):
        assert (one.stamp_ns, one.exposure_ms) == (two.stamp_ns, two.exposure_ms)
        np.testing.assert_array_equal(one.image, two.image)
    np.testing.assert_array_equal(again.wheels.readings, recording.wheels.readings)
    np.testing.assert_array_equal(again.wheels.stamps_ns, recording.wheels.stamps_ns)
    np.testing.assert_allclose(again.robot.T_base_camera, recording.robot.T_base_camera, atol=1e-9)
    assert again.calibration == recording.calibration


def test_the_truth_lies_beside_the_bag(bag):
    recording, path, messages = bag
    files = files_beside(path)
    assert {file.name for file in files.values()} == {
        "drive.groundtruth.tum",
        "drive.groundtruth_base.tum",
        "drive.truth.yaml",
        "drive.robot.yaml",
    }
    np.testing.assert_allclose(read_tum(files["camera"]).positions, recording.camera_truth.positions, atol=1e-8)
    base = read_tum(files["base"])
    position = messages["/ground_truth"][7][1].pose.position
    np.testing.assert_allclose(base.positions[7], [position.x, position.y, position.z], atol=1e-8)
    truth = yaml.safe_load(files["truth"].read_text())
    assert truth["wheel_base"] == recording.simulation.robot.true.wheel_base_m


def test_the_same_seed_gives_the_same_file(tmp_path):
    one, two = (write(tmp_path / name, simulated(duration_s=0.6, imu=True)) for name in ("one.bag", "two.bag"))
    assert one.read_bytes() == two.read_bytes()
    assert files_beside(one)["truth"].read_bytes() == files_beside(two)["truth"].read_bytes()


def test_a_distorted_camera_says_so(tmp_path):
    camera = CameraModel(width=104, height=64, distortion=(-0.1, 0.02, 0.001, 0.0))
    path = write(tmp_path / "lens.bag", simulated(duration_s=0.5, camera=camera))
    lens = open_recording(path).calibration.lens
    assert lens.model == "RadTan"
    assert lens.distortion[:4] == camera.distortion


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(OutputError, match="nowhere"):
        write_files_beside(tmp_path / "nowhere" / "a.bag", simulated())
