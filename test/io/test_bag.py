# SPDX-License-Identifier: BSD-3-Clause
import re

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Frame, SkippedFrame, TopicNames, WheelUnit
from ceiling_dso_ros.io.ros_messages import TYPES, header, message, transform_stamped

START_NS, PERIOD_NS = 1_700_000_001_030_042_017, 33_333_333
WIDTH, HEIGHT = 96, 80
K = np.array([[60.0, 0, 47.5], [0, 61.0, 39.5], [0, 0, 1]])
IMAGE, INFO, EXPOSURE = "/camera/up/image_raw", "/camera/up/camera_info", "/camera/up/exposure"
ROBOT = "ticks_per_turn: 1000\nwheel_radius: [0.098, 0.099]\nwheel_base: 0.485\n"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "tour.bag"


def stamp_ns(index):
    return START_NS + index * PERIOD_NS


def picture(index=0, dtype=np.uint8):
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    grey = (2 + np.sin((x + 3 * index) / 5) + np.cos(y / 7)) / 4
    return (grey * np.iinfo(dtype).max).astype(dtype)


def write_images(bag, indices=range(4), topic=IMAGE):
    for index in indices:
        bag.image(topic, stamp_ns(index), "optical", picture(index))


def write_info(bag, topic=INFO, **changes):
    bag.camera_info(topic, START_NS, "optical", **{"size": (WIDTH, HEIGHT), "K": K, **changes})


def write_damaged(bag, topic, type_name, data=b"\x01\x02\x03"):
    """A message of a topic that has none yet, or has been written to before, that cannot be deserialised."""
    connection = bag._connections.get(topic) or bag._writer.add_connection(topic, type_name, typestore=TYPES)
    bag._connections[topic] = connection
    bag._writer.write(connection, stamp_ns(9), data)


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
    expected = f"{path}: topic {IMAGE} is not in the bag; its image topics are /front/image_raw, /rear/image/compressed"
    with pytest.raises(InputError, match=re.escape(expected)):
        open_recording(path)
    expected = f"{path}: topic /wheel/left/ticks holds std_msgs/msg/Int32, no images; its image topics are /front"
    with pytest.raises(InputError, match=re.escape(expected)):
        open_recording(path, TopicNames(image="/wheel/left/ticks"))


@pytest.mark.parametrize("with_ticks", [False, True])
def test_a_bag_without_images(path, with_ticks):
    with BagWriter(path) as bag:
        if with_ticks:
            bag.ticks("/wheel/left/ticks", START_NS, 1)
    with pytest.raises(InputError, match=re.escape(f"{path}: topic {IMAGE} is not in the bag; it has no images")):
        open_recording(path)


def test_a_bag_without_camera_info(path, tmp_path):
    with BagWriter(path) as bag:
        write_images(bag)
        write_info(bag, "/front/camera_info")
    expected = (
        f"{path}: no camera_info on {INFO} (in the bag: /front/camera_info); "
        "name its topic or give a camera.txt with the calibration"
    )
    with pytest.raises(InputError, match=re.escape(expected)):
        open_recording(path)

    (tmp_path / "camera.txt").write_text("Pinhole 70 71 47.5 39.5 0\n96 80\nnone\n96 80\n")
    recording = open_recording(path, camera_file=tmp_path / "camera.txt")
    assert recording.calibration.camera.fx == 70
    assert len(list(recording.frames())) == 4


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"K": np.full((3, 3), np.nan)}, "a number of the camera is not finite; is the camera calibrated?"),
        ({"K": np.zeros((3, 3))}, "the focal lengths fx=0 fy=0 must be positive; is the camera calibrated?"),
        ({"distortion": [0.1] * 3}, "3 coefficients in D instead of 4, 5 or 8 for plumb_bob"),
    ],
)
def test_a_camera_info_of_no_camera(path, changes, complaint):
    with BagWriter(path) as bag:
        write_images(bag)
        write_info(bag, **changes)
    with pytest.raises(InputError, match=re.escape(f"{path}, {INFO}: {complaint}")):
        open_recording(path)


def test_a_damaged_camera_info(path):
    with BagWriter(path) as bag:
        write_images(bag)
        write_damaged(bag, INFO, "sensor_msgs/msg/CameraInfo")
    with pytest.raises(InputError, match=re.escape(f"{path}, {INFO}: damaged message of 3 bytes")):
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


def test_the_times_of_images_are_those_of_their_headers_and_tell_how_late_they_were_recorded(path):
    with BagWriter(path) as bag:
        write_info(bag)
        for index in range(30):
            image = message(
                "sensor_msgs/Image",
                **{"header": header(stamp_ns(index), "optical"), "height": HEIGHT, "width": WIDTH, "encoding": "mono8"},
                **{"is_bigendian": 0, "step": WIDTH, "data": picture().reshape(-1)},
            )
            bag.write(IMAGE, stamp_ns(index) + 7_000_000, image)
    times = open_recording(path).image_times()
    assert (times.first_ns, times.last_ns, times.delay_ns) == (stamp_ns(0), stamp_ns(29), 7_000_000)


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


def open_noisily(path, **options):
    """The recording and its warnings."""
    warnings = []
    return open_recording(path, warn=warnings.append, **options), warnings


def change_info(**changes):
    """Write one camera_info with further fields."""

    def write(bag, index=0):
        fields = camera_info_message(stamp_ns(index))
        for name, value in changes.items():
            setattr(fields, name, value)
        bag.write(INFO, stamp_ns(index), fields)

    return write


def camera_info_message(time_ns):
    written = []

    class Kept(BagWriter):
        def __init__(self):
            self._counts = {}

        def write(self, topic, stamp_ns, content, latched=False):
            written.append(content)

    Kept().camera_info(INFO, time_ns, "optical", (WIDTH, HEIGHT), K)
    return written[0]


def test_binning_and_region_of_interest(path):
    """The images are 96x80; the sensor has 300x200."""
    region = message("sensor_msgs/RegionOfInterest", x_offset=40, y_offset=20, width=192, height=160, do_rectify=True)
    of_sensor = np.array([120.0, 0, 135.5, 0, 122.0, 99.5, 0, 0, 1])
    write = change_info(width=300, height=200, K=of_sensor, binning_x=2, binning_y=2, roi=region)
    with BagWriter(path) as bag:
        write(bag)
        write_images(bag)
    recording = open_recording(path)
    assert recording.calibration.camera.parameters.tolist() == [60.0, 61.0, 47.5, 39.5]
    assert all(isinstance(frame, Frame) for frame in recording.frames())


def test_rectified_images(path):
    barrel = np.array([-0.1, 0.01, 0.0, 0.0, 0.0])
    P = np.array([55.0, 0, 45.0, 0, 0, 56.0, 41.0, 0, 0, 0, 1, 0])
    with BagWriter(path) as bag:
        change_info(D=barrel, P=P)(bag)
        write_images(bag, topic="/camera/up/image_rect")
    topics = TopicNames(image="/camera/up/image_rect")
    doubted, warnings = open_noisily(path, topics=topics)
    assert doubted.calibration.lens.distortion == tuple(barrel)
    assert len(warnings) == 1
    assert "/camera/up/image_rect: by its name these images are rectified" in warnings[0]
    recording, warnings = open_noisily(path, topics=topics, rectified=True)
    assert recording.calibration.keeps_images
    assert recording.calibration.camera.parameters.tolist() == [55.0, 56.0, 45.0, 41.0]
    assert warnings == []


def test_a_calibration_that_comes_late_is_waited_for(path):
    with BagWriter(path) as bag:
        for index in range(3):
            change_info(K=np.zeros(9))(bag, index)
        write_info(bag)
        write_images(bag)
    recording, warnings = open_noisily(path)
    assert recording.calibration.camera.fx == 60.0
    assert warnings == [
        f"{path}, {INFO}: the focal lengths fx=0 fy=0 must be positive; is the camera calibrated?; "
        "a later camera_info is used"
    ]
    assert len(list(recording.frames())) == 4
    assert len(warnings) == 1


def test_a_calibration_that_changes_is_warned_of(path):
    with BagWriter(path) as bag:
        for index in range(4):
            write_info(bag, K=K if index < 2 else K + np.diag([1.0, 0.0, 0.0]))
            write_images(bag, [index])
    recording, warnings = open_noisily(path)
    assert warnings == []
    assert len(list(recording.frames())) == 4
    assert len(warnings) == 1
    assert f"{path}, {INFO}: camera_info changes at 1700000001.030042017 to LensCamera(" in warnings[0]
    assert "fx=61.0" in warnings[0]


@pytest.mark.parametrize("form", ["folder", "camera file"])
def test_rectified_is_about_a_camera_info(path, tmp_path, form):
    with BagWriter(path) as bag:
        write_info(bag)
        write_images(bag)
    options = {"camera_file": tmp_path / "camera.txt"} if form == "camera file" else {}
    with pytest.raises(InputError, match="'rectified' means P of camera_info"):
        open_recording(tmp_path if form == "folder" else path, rectified=True, **options)


def test_the_compressed_mosaic_of_a_sensor(path):
    data = cv2.imencode(".png", picture())[1].tobytes()
    with BagWriter(path) as bag:
        write_info(bag)
        bag.compressed_image(IMAGE + "/compressed", START_NS, "optical", data, "bayer_rggb8; png compressed ")
    (frame,) = open_recording(path).frames()
    np.testing.assert_array_equal(frame.image, cv2.cvtColor(picture(), cv2.COLOR_BayerBG2GRAY))
