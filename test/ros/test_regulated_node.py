# SPDX-License-Identifier: BSD-3-Clause
"""With frame_rate auto and mapping sequential, dso_node uses the images of `run --fps auto`, with the same poses."""

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from dynamic_reconfigure.encoding import Config  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from ceiling_dso_ros.cfg import DsoConfig  # noqa: E402
from ceiling_dso_ros.dso import OdometryConfig  # noqa: E402
from ceiling_dso_ros.dso.config import WindowConfig  # noqa: E402
from ceiling_dso_ros.io.warning_log import WarningLog  # noqa: E402
from ceiling_dso_ros.msg import VisualOdometryStatus  # noqa: E402
from ceiling_dso_ros.playback.playback import Playback  # noqa: E402
from ceiling_dso_ros.playback.visual_run import VisualRun  # noqa: E402
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time  # noqa: E402
from ceiling_dso_ros.ros.dso_server import DsoServer  # noqa: E402
from ceiling_dso_ros.simulation.camera import CameraModel  # noqa: E402
from ceiling_dso_ros.simulation.config import SimulationConfig  # noqa: E402
from ceiling_dso_ros.simulation.recording import SimulatedRecording  # noqa: E402

WINDOW = {"max_keyframes": 5, "min_keyframes": 4, "candidate_points": 500, "active_points": 500}


def through_the_node(world, recording, frames):
    """The statuses of the images."""
    server, camera = DsoServer(), recording.calibration.camera
    K = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    info = CameraInfo(width=camera.width, height=camera.height, K=K, distortion_model="plumb_bob", D=[0.0] * 5)
    world.callbacks["camera_info"](info)
    server._reconfigure(Config({**DsoConfig.defaults, "frame_rate": "auto"}), 0)
    statuses = []
    for frame in frames:
        header = Header(stamp=ros_time(frame.stamp_ns), frame_id="camera")
        height, width = frame.image.shape
        server._process_safely(Image(header, height, width, "mono8", 0, width, frame.image.tobytes()))
        statuses.append(world.newest["visual_odometry/status"])
    return statuses


def test_live_and_offline_use_the_same_images(rosless, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.ros.dso_server.CALIBRATION_TIMEOUT_S", 0.0)
    camera = CameraModel(width=424, height=240, fps=15.0)
    recording = SimulatedRecording(SimulationConfig("stop_and_go", "factory", camera=camera, duration_s=8.5))
    recording.uses_exposures = False  # nobody publishes them here
    frames = list(recording.frames())
    statuses = through_the_node(rosless(mapping="sequential", window=WINDOW), recording, frames)

    visual = VisualRun.of_camera(recording.calibration, config=OdometryConfig(window=WindowConfig(**WINDOW)))
    visual.regulate(True)
    playback, offline = Playback(visual, WarningLog(print)), []
    for frame in frames:
        if not playback.leaves_out(frame.stamp_ns):
            offline.append(visual.track(frame.image, frame.stamp_ns, None).status)

    used = [status for status in statuses if status.rate_reason != VisualOdometryStatus.LEFT_OUT]
    assert [status.header.stamp.to_nsec() for status in used] == [status.stamp_ns for status in offline]
    assert statuses[-1].left_out == len(statuses) - len(used) == visual.regulation.summary()["left_out"] > 10
    for live, status in zip(used, offline):
        expected = [] if status.T_keyframe_camera is None else [pose_from_matrix(status.T_keyframe_camera)]
        assert [relative.pose for relative in live.pose] == expected
    assert used[-1].pose
