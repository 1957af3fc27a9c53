# SPDX-License-Identifier: BSD-3-Clause
"""The server of dso_node, without a master: what images, calibrations and errors may not do to it."""

import threading

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

import rospy  # noqa: E402
from dynamic_reconfigure.encoding import Config  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from straight_drive import Drive  # noqa: E402

from ceiling_dso_ros.cfg import DsoConfig  # noqa: E402
from ceiling_dso_ros.dso import OdometryStatus, TrackingState  # noqa: E402
from ceiling_dso_ros.dso.tracking.track_history import ExpectedMotion  # noqa: E402
from ceiling_dso_ros.io.errors import LONGEST_MESSAGE  # noqa: E402
from ceiling_dso_ros.msg import VisualOdometryStatus  # noqa: E402
from ceiling_dso_ros.ros.conversions import ros_time  # noqa: E402
from ceiling_dso_ros.ros.data_clock import DataClock  # noqa: E402
from ceiling_dso_ros.ros.dso_server import DsoServer  # noqa: E402
from ceiling_dso_ros.ros.reconfigure import ReconfigureServer  # noqa: E402
from ceiling_dso_ros.ros.visual_input import VisualInput  # noqa: E402

WIDTH, HEIGHT = 200, 160


class CameraDrive:
    """A dso_node that sees images of noise."""

    def __init__(self, world):
        self.world, self.server, self._count = world, DsoServer(), 0
        self._pixels = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)

    def calibrate(self, width=WIDTH, height=HEIGHT):
        fx, fy = max(100.0, width / 2), max(100.0, height / 2)
        K = [fx, 0.0, width / 2, 0.0, fy, height / 2, 0.0, 0.0, 1.0]
        info = CameraInfo(width=width, height=height, K=K, distortion_model="plumb_bob", D=[0.0] * 5)
        self.world.callbacks["camera_info"](info)

    def see(self, width=WIDTH, height=HEIGHT):
        """The status of an image; as the main loop of the node does with it."""
        self._count += 1
        header = Header(stamp=ros_time(Drive.BEGIN_NS + self._count * 33_333_333), frame_id="camera")
        pixels = self._pixels[:height, :width]
        image = Image(header, height, width, "mono8", 0, width, pixels.tobytes())
        self.server._process_safely(image)
        return self.world.newest["visual_odometry/status"]


@pytest.fixture
def camera(rosless, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.ros.dso_server.CALIBRATION_TIMEOUT_S", 0.0)
    return CameraDrive(rosless())


def test_a_size_that_cannot_be_tracked_is_stated_and_survived(camera):
    camera.calibrate(100, 100)
    for _ in range(3):
        status = camera.see(100, 100)
        assert status.state == VisualOdometryStatus.WAITING
        assert "cannot track: " in status.message
    assert status.message in camera.world.diagnostics().message
    camera.calibrate()
    assert camera.see().state == VisualOdometryStatus.INITIALIZING


def test_a_rate_that_makes_no_sense_is_refused_while_the_node_runs(camera):
    """As dynamic_reconfigure would set it; all other changes that come with it are refused, too."""
    server = ReconfigureServer.__new__(ReconfigureServer)  # its own begin needs a master
    server.type, server.ns, server.mutex = DsoConfig, "~/", threading.Lock()
    server.config, server.callback = Config(DsoConfig.defaults), camera.server._reconfigure
    with pytest.raises(rospy.ServiceException, match=r"frame_rate=1e-300: 0 for all .*; nothing is changed$"):
        server.update_configuration({"frame_rate": "1e-300", "map_period": 7.0})
    assert camera.server._map.period_s != 7.0
    assert server.config["frame_rate"] == "0"


def test_a_camera_info_of_other_images_costs_neither_map_nor_memory(camera):
    """Of 192x65535 pixels, the odometry would take 2 GB."""
    camera.calibrate()
    camera.see()
    run = camera.server._run
    camera.calibrate(192, 65535)
    status = camera.see()
    assert (status.state, status.rejected, camera.server._run) == (VisualOdometryStatus.INITIALIZING, 0, run)
    assert "camera_info: it is for images of 192x65535, not" in camera.world.diagnostics().message
    camera.calibrate()
    camera.see()
    assert "camera_info" not in camera.world.diagnostics().message
    assert camera.server._run is run


def test_what_is_said_of_an_image_is_one_line_of_bounded_length(camera):
    camera.calibrate()
    camera.see()
    wrong = Image(Header(stamp=ros_time(Drive.BEGIN_NS)), HEIGHT, WIDTH, "x\n" * 3000, 0, WIDTH, b"")
    camera.server._process_safely(wrong)
    status = camera.world.newest["visual_odometry/status"]
    for said in (camera.world.logged[-1], status.message, camera.world.diagnostics().message):
        assert said.isprintable()
        assert len(said) <= LONGEST_MESSAGE


def test_an_error_in_publishing_concerns_one_image(camera, monkeypatch):
    camera.calibrate()
    camera.see()
    with monkeypatch.context() as broken:
        broken.setattr(camera.server._publisher, "publish_status", lambda *_: 1 / 0)
        camera.see()
    assert "ZeroDivisionError" in camera.world.logged[-1]
    before = camera.world.sent["visual_odometry/status"]
    assert camera.see().state == VisualOdometryStatus.INITIALIZING
    assert camera.world.sent["visual_odometry/status"] == before + 1


def closed(*_):
    raise rospy.ROSException("publish() to a closed topic")


def test_an_image_at_the_moment_of_the_end_forgets_nothing(camera, monkeypatch):
    """Topics are closed at once; what was tracked so far is still to be written."""
    camera.calibrate()
    camera.see()
    forgotten = []
    monkeypatch.setattr(camera.server._keeper, "clear", lambda: forgotten.append(True))
    monkeypatch.setattr(camera.server._publisher, "publish", closed)
    monkeypatch.setattr(camera.server._publisher, "publish_status", closed)
    camera.world.is_shutdown = True
    camera.see()
    assert forgotten == camera.world.logged == []


def test_a_silent_publisher_of_exposures_is_stated(camera, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.ros.exposure_input.TIMEOUT_S", 1e-3)
    camera.calibrate()
    camera.world.listened.add("exposure")
    for _ in range(10):
        camera.see()
    assert "/exposure comes too late or not at all: images do not wait for it" in camera.world.diagnostics().message


def test_the_cameras_trajectories_are_saved(camera, tmp_path):
    camera.calibrate()
    camera.see()
    answer = camera.world.call("~save_trajectory", directory=str(tmp_path / "out"))
    assert answer.success, answer.message
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "camera.tum",
        "camera_final.tum",
        "keyframes.tum",
    ]


class Standing:
    """An odometry whose camera has a map and stands."""

    def __init__(self):
        self.tracked_ns, self.map = [], None

    def expect(self, stamp_ns, prediction):
        return ExpectedMotion(0.0, 0.0, predicted=True)

    def track(self, image, stamp_ns, exposure_ms, prediction, right=None):
        self.tracked_ns.append(stamp_ns)
        pose = {"T_world_camera": np.eye(4), "T_keyframe_camera": np.eye(4), "covariance": np.eye(6)}
        return OdometryStatus(stamp_ns, TrackingState.TRACKING, 0, keyframe_id=0, rmse=4.0, **pose)

    def reset(self):
        pass


def stand(camera, frame_rate, images, decoded):
    """Statuses of images under a Standing odometry."""
    camera.server._reconfigure(Config({**DsoConfig.defaults, "frame_rate": frame_rate}), 0)
    camera.calibrate()
    statuses = [camera.see()]
    camera.server._run.odometry = Standing()
    before = len(decoded)
    statuses += [camera.see() for _ in range(images)]
    return statuses, len(decoded) - before


@pytest.fixture
def decoded(monkeypatch):
    """One entry for each image that was decoded."""
    found = []

    def image_array(message):
        rng = np.random.default_rng(len(found))  # one that repeats another has no pose
        found.append(rng.integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8))
        return found[-1]

    monkeypatch.setattr("ceiling_dso_ros.ros.dso_server.image_array", image_array)
    return found


def test_images_of_a_robot_that_stands_are_left_out_before_they_are_decoded(camera, decoded):
    statuses, count = stand(camera, "auto", 150, decoded)
    out = [status for status in statuses if status.rate_reason == VisualOdometryStatus.LEFT_OUT]
    assert len(statuses) - 1 - len(out) == count == len(camera.server._run.odometry.tracked_ns)
    assert len(out) > 70
    assert statuses[-1].left_out == len(out)
    last = out[-1]
    assert (last.state, list(last.pose)) == (VisualOdometryStatus.TRACKING, [])
    assert last.message == "left out: hardly anything has moved"
    assert 1.0 < last.rate < 4.0
    assert last.predict_from.to_nsec() in camera.server._run.odometry.tracked_ns
    assert {status.rate_reason for status in statuses[100:]} == {
        VisualOdometryStatus.LEFT_OUT,
        VisualOdometryStatus.DUE,
    }
    camera.server._images.heard()  # they have not come by the topic
    said = camera.world.diagnostics()
    assert said.message.startswith("tracking")
    assert {value.key: value.value for value in said.values}["left out"].startswith(f"{len(out)}; 2")


def test_the_fusion_takes_an_image_that_is_left_out_for_none(camera, decoded):
    """So it is neither a pose nor a loss, and its message still says that the camera lives."""
    statuses, _ = stand(camera, "auto", 100, decoded)
    visual = VisualInput(DataClock())
    for status in statuses[70:]:
        left_out = status.rate_reason == VisualOdometryStatus.LEFT_OUT
        assert (visual.status(status) is None) == left_out


def test_a_fixed_rate_leaves_out_nothing_that_reaches_the_odometry(camera, decoded):
    for frame_rate in ("0", "15"):
        statuses, count = stand(camera, frame_rate, 100, decoded)
        assert count == 100
        assert {(status.rate_reason, status.rate, status.left_out) for status in statuses} == {(0, 0.0, 0)}
    assert camera.server._frame_rate.frame_rate == 15.0


def test_the_rate_may_follow_the_motion_from_now_on(camera, decoded):
    statuses, _ = stand(camera, "auto", 120, decoded)
    camera.server._reconfigure(Config({**DsoConfig.defaults, "frame_rate": "0"}), 0)
    assert [camera.see().left_out for _ in range(20)] == [statuses[-1].left_out] * 20
