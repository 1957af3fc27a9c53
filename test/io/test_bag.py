# SPDX-License-Identifier: BSD-3-Clause
import re

import cv2
import numpy as np
import pytest
from small_bag import (
    EXPOSURE,
    HEIGHT,
    IMAGE,
    START_NS,
    WIDTH,
    K,
    picture,
    stamp_ns,
    write_damaged,
    write_images,
    write_info,
)

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Frame, SkippedFrame, TopicNames, WheelUnit
from ceiling_dso_ros.io.ros_messages import header, message, transform_stamped

ROBOT = "ticks_per_turn: 1000\nwheel_radius: [0.098, 0.099]\nwheel_base: 0.485\n"


def test_images_stamps_and_exposures(path):
    with BagWriter(path) as bag:
        write_info(bag)
        for index in (0, 2, 3):
            bag.exposure(EXPOSURE, stamp_ns(index), "optical", 5 + index if index < 3 else 0.0)
        write_images(bag)
    recording = open_recording(path)
    frames = list(recording.frames())

    assert (recording.name, len(recording)) == ("tour", 4)
    assert recording.calibration.camera.parameters.tolist() == [60.0, 61.0, 47.5, 39.5]
    assert recording.wheels is recording.robot is recording.ground_truth_path is None
    assert [frame.stamp_ns for frame in frames] == [stamp_ns(index) for index in range(4)]
    assert [frame.exposure_ms for frame in frames] == [5.0, None, 7.0, None]
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, picture(index))


def test_exposures_may_come_after_their_images(path):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        bag.exposure(EXPOSURE, stamp_ns(1), "optical", 3.0)
    assert [frame.exposure_ms for frame in open_recording(path).frames()] == [None, 3.0, None, None]


@pytest.mark.parametrize(
    ("encoding", "image"),
    [
        ("mono8", picture()),
        ("8UC1", picture()),
        ("bgr8", np.dstack([picture()] * 3)),
        ("rgb8", np.dstack([picture()] * 3)),
        ("mono16", picture(dtype=np.uint16)),
        ("16UC1", picture(dtype=np.uint16)),
    ],
)
def test_every_encoding(path, encoding, image):
    with BagWriter(path) as bag:
        write_info(bag)
        bag.image(IMAGE, START_NS, "optical", image, encoding)
    (frame,) = open_recording(path).frames()
    np.testing.assert_array_equal(frame.image, image if image.ndim == 2 else image[:, :, 0])


@pytest.mark.parametrize("suffix", ["png", "jpeg"])
@pytest.mark.parametrize("asked_for", [IMAGE, IMAGE + "/compressed"])
def test_compressed_images(path, suffix, asked_for):
    data = cv2.imencode("." + suffix, picture())[1].tobytes()
    with BagWriter(path) as bag:
        write_info(bag)
        bag.compressed_image(IMAGE + "/compressed", START_NS, "optical", data, suffix)
    (frame,) = open_recording(path, TopicNames(image=asked_for)).frames()
    np.testing.assert_array_equal(frame.image, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE))


def test_other_topics(path):
    with BagWriter(path) as bag:
        write_info(bag, "/cam/camera_info")
        write_info(bag, "/calibration", K=2 * K - np.diag([0, 0, 1]), size=(2 * WIDTH, 2 * HEIGHT))
        write_images(bag, topic="/cam/image")
    assert open_recording(path, TopicNames(image="/cam/image")).calibration.lens.fx == 60
    topics = TopicNames(image="/cam/image", camera_info="/calibration")
    assert open_recording(path, topics).calibration.lens.fx == 120


def test_bad_frames_are_skipped_and_named(path):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag, [0, 1, 1, 0])
        bag.image(IMAGE, stamp_ns(2), "optical", picture()[:40])
        truncated = message(
            "sensor_msgs/Image",
            **{"header": header(stamp_ns(3), "optical"), "height": HEIGHT, "width": WIDTH, "encoding": "mono8"},
            **{"is_bigendian": 0, "step": WIDTH, "data": np.zeros(100, np.uint8)},
        )
        bag.write(IMAGE, stamp_ns(3), truncated)
        bag.image(IMAGE, stamp_ns(4), "optical", picture(), "8SC1")
        write_damaged(bag, IMAGE, "sensor_msgs/msg/Image")
        write_images(bag, [10])
    recording = open_recording(path)
    frames = list(recording.frames())

    assert len(recording) == len(frames) == 9
    assert [i for i, frame in enumerate(frames) if isinstance(frame, Frame)] == [0, 2, 8]
    reasons = [frame.reason for frame in frames if isinstance(frame, SkippedFrame)]
    where = f"{path}, {IMAGE}, message"
    assert reasons[0].startswith(f"{where} 2: the stamp 1700000001.030042017 repeats that of the last frame")
    assert reasons[1].startswith(f"{where} 4: the stamp")
    assert reasons[4].startswith(f"{where} 7: image encoding '8SC1' cannot be read as grey; those that can: mono,")
    assert reasons[2:] == [
        f"{where} 5: the image is 96x40, but the calibration is for 96x80; frame skipped",
        f"{where} 6: truncated image: 100 bytes instead of 7680; frame skipped",
        reasons[4],
        f"{where} 8: damaged message of 3 bytes; frame skipped",
    ]


def test_a_topic_that_is_not_there_lists_those_that_are(path):
    with BagWriter(path) as bag:
        write_images(bag, topic="/front/image_raw")
        bag.compressed_image("/rear/image/compressed", START_NS, "optical", b"", "jpeg")
        bag.ticks("/wheel/left/ticks", START_NS, 1)
    others = "choose with --image-topic: it has /front/image_raw, /rear/image/compressed"
    expected = f"{path}: topic {IMAGE} is not in the bag; {others}"
    with pytest.raises(InputError, match=re.escape(expected)):
        open_recording(path)
    expected = (
        f"{path}: topic /wheel/left/ticks holds std_msgs/msg/Int32, no images; choose with --image-topic: it has /front"
    )
    with pytest.raises(InputError, match=re.escape(expected)):
        open_recording(path, TopicNames(image="/wheel/left/ticks"))


@pytest.mark.parametrize("with_ticks", [False, True])
def test_a_bag_without_images(path, with_ticks):
    with BagWriter(path) as bag:
        if with_ticks:
            bag.ticks("/wheel/left/ticks", START_NS, 1)
    with pytest.raises(InputError, match=re.escape(f"{path}: topic {IMAGE} is not in the bag; it has no images")):
        open_recording(path)


def test_a_topic_of_another_type(path):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        bag.ticks(EXPOSURE, START_NS, 5)
    expected = f"{path}: topic {EXPOSURE} holds std_msgs/msg/Int32 instead of ceiling_dso_ros/msg/Exposure"
    with pytest.raises(InputError, match=re.escape(expected)):
        list(open_recording(path).frames())


def test_ticks(path):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        for index, (left, right) in enumerate([(1, -5), (4, -6), (9, -7)]):
            bag.ticks("/wheel/left/ticks", stamp_ns(index), left)
            bag.ticks("/wheel/right/ticks", stamp_ns(index), right)
    wheels = open_recording(path).wheels
    assert wheels.stamps_ns.tolist() == [stamp_ns(index) for index in range(3)]
    assert wheels.readings.tolist() == [[1, -5], [4, -6], [9, -7]]


def test_angles_of_joint_states(path, tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT + "T_base_camera: {xyz: [0, 0, 0], quat_xyzw: [0, 0, 0, 1]}\n")
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        for index in range(3):
            angles = [0.0, index * np.pi, -index * np.pi / 2]
            bag.joint_state("/joint_states", stamp_ns(index), ["caster", "wheel_right", "wheel_left"], angles)
    wheels = open_recording(path, robot_file=tmp_path / "robot.yaml").wheels
    assert wheels.stamps_ns.tolist() == [stamp_ns(index) for index in range(3)]
    assert wheels.unit is WheelUnit.RADIANS
    np.testing.assert_array_equal(wheels.readings, [[0.0, 0.0], [-np.pi / 2, np.pi], [-np.pi, 2 * np.pi]])


def test_the_mount_comes_from_tf_static_through_chains(path, tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    up, quarter_turn = np.eye(4), np.eye(4)
    up[2, 3] = 0.6
    quarter_turn[:2, :2] = [[0, -1], [1, 0]]
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        bag.tf_static(START_NS, [("mast", "optical", quarter_turn)])
        bag.tf_static(START_NS, [("base_link", "mast", up)])
    robot = open_recording(path, robot_file=tmp_path / "robot.yaml").robot
    np.testing.assert_allclose(robot.T_base_camera, up @ quarter_turn, atol=1e-15)


def test_a_mount_that_nobody_knows_is_reported_with_the_frames_that_were_looked_up(path, tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        bag.tf_static(START_NS, [("base_link", "laser", np.eye(4))])
    expected = f"{path}: tf has no base_link -> optical, its frames are base_link, laser; write T_base_camera into "
    with pytest.raises(InputError, match=re.escape(expected)):
        _ = open_recording(path, robot_file=tmp_path / "robot.yaml").robot


def test_a_mount_on_tf_counts_where_tf_static_has_none(path, tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        for second in range(3):
            moving = [transform_stamped(START_NS + second, "/base_link", "/optical", np.diag([1.0, -1.0, -1.0, 1.0]))]
            bag.write("/tf", START_NS + second, message("tf2_msgs/TFMessage", transforms=moving))
    robot = open_recording(path, robot_file=tmp_path / "robot.yaml").robot
    np.testing.assert_allclose(robot.T_base_camera, np.diag([1.0, -1.0, -1.0, 1.0]), atol=1e-15)


def test_frames_can_be_named(path, tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT)
    with BagWriter(path) as bag:
        write_info(bag)
        bag.image(IMAGE, START_NS, "", picture())
        bag.tf_static(START_NS, [("chassis", "lens", np.eye(4))])
    with pytest.raises(InputError, match=f"{IMAGE} do not name their frame.*--camera-frame"):
        _ = open_recording(path, robot_file=tmp_path / "robot.yaml").robot
    topics = TopicNames(base_frame="chassis", camera_frame="/lens")
    np.testing.assert_array_equal(
        open_recording(path, topics, robot_file=tmp_path / "robot.yaml").robot.T_base_camera, np.eye(4)
    )


def test_a_frame_that_is_named_for_nothing_is_told(path, tmp_path):
    (tmp_path / "robot.yaml").write_text(ROBOT + "T_base_camera: {xyz: [0, 0, 1], quat_xyzw: [0, 0, 0, 1]}\n")
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
        bag.tf_static(START_NS, [("base_link", "lens", np.eye(4))])
    warnings = []
    for topics in (TopicNames(), TopicNames(camera_frame="lens")):
        recording = open_recording(path, topics, robot_file=tmp_path / "robot.yaml", warn=warnings.append)
        assert recording.robot.T_base_camera[2, 3] == 1.0
    assert len(warnings) == 1
    assert "robot.yaml: its T_base_camera is used, and not the pose of lens in tf" in warnings[0]


@pytest.mark.parametrize("wrong_s", [0, -3600, 3600])
def test_the_times_of_images_are_those_of_their_headers_and_tell_how_late_they_were_recorded(path, wrong_s):
    """A single wrong stamp is no time of the recording: parts of it would be of another hour."""
    with BagWriter(path) as bag:
        write_info(bag)
        for index in range(30):
            told_ns = stamp_ns(index) + (wrong_s * 10**9 if index == 3 else 0)
            image = message(
                "sensor_msgs/Image",
                **{"header": header(told_ns, "optical"), "height": HEIGHT, "width": WIDTH, "encoding": "mono8"},
                **{"is_bigendian": 0, "step": WIDTH, "data": picture().reshape(-1)},
            )
            bag.write(IMAGE, stamp_ns(index) + 7_000_000, image)
    times = open_recording(path).image_times()
    assert (times.first_ns, times.last_ns, times.delay_ns) == (stamp_ns(0), stamp_ns(29), 7_000_000)


def test_of_images_whose_stamps_are_hours_apart_some_are_used(path):
    with BagWriter(path) as bag:
        write_info(bag)
        for index in range(2):
            image = message(
                "sensor_msgs/Image",
                **{"header": header(stamp_ns(index) - index * 7200 * 10**9, "optical")},
                **{"height": HEIGHT, "width": WIDTH, "encoding": "mono8", "is_bigendian": 0, "step": WIDTH},
                data=picture().reshape(-1),
            )
            bag.write(IMAGE, stamp_ns(index), image)
    times = open_recording(path).image_times()
    assert times.first_ns == times.last_ns
    assert times.first_ns in (stamp_ns(0), stamp_ns(1) - 7200 * 10**9)


def test_files_beside_the_bag_belong_to_it(path, tmp_path):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
    mount = "T_base_camera: {xyz: [0, 0, 0], quat_xyzw: [0, 0, 0, 1]}\n"
    (tmp_path / "tour.robot.yaml").write_text(ROBOT + mount)
    (tmp_path / "other.yaml").write_text(ROBOT.replace("1000", "2000") + mount)
    (tmp_path / "tour.groundtruth.tum").write_text("1 0 0 0 0 0 0 1\n")
    assert open_recording(path).robot.ticks_per_turn == 1000
    assert open_recording(path, robot_file=tmp_path / "other.yaml").robot.ticks_per_turn == 2000
    assert open_recording(path).ground_truth_path == tmp_path / "tour.groundtruth.tum"


def test_the_compressed_mosaic_of_a_sensor(path):
    data = cv2.imencode(".png", picture())[1].tobytes()
    with BagWriter(path) as bag:
        write_info(bag)
        bag.compressed_image(IMAGE + "/compressed", START_NS, "optical", data, "bayer_rggb8; png compressed ")
    (frame,) = open_recording(path).frames()
    np.testing.assert_array_equal(frame.image, cv2.cvtColor(picture(), cv2.COLOR_BayerBG2GRAY))
