# SPDX-License-Identifier: BSD-3-Clause
"""Small valid recordings, of which wrong ones are made, and all that is read of a recording."""

from pathlib import Path
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.dso import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.fusion.config import FusionConfig, RobotModel
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.io.message_writer import MessageWriter
from ceiling_dso_ros.io.recording import Frame, Recording
from ceiling_dso_ros.io.ros_messages import RosMessage, header, message
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.playback.camera_spool import CameraSpool
from ceiling_dso_ros.playback.fusion_spool import FusionSpool
from ceiling_dso_ros.playback.spool import SpoolFolder

WIDTH, HEIGHT, IMAGES = 96, 80, 3
START_NS, PERIOD_NS = 1_700_000_001_030_042_017, 33_333_333
SPOOLED = 60  # images of a spool
UP = np.eye(4)
VIEWER = "/device_0/sensor_0"  # of a recording of realsense-viewer


def stamp_ns(index: float) -> int:
    """Of an image, or of what is between two."""
    return START_NS + round(index * PERIOD_NS)


def picture(index: int = 0, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(height, width) uint8 with some texture."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return (127 + 60 * np.sin((x + 3 * index) / 5) + 60 * np.cos(y / 7)).astype(np.uint8)


def write_folder(folder: Path, cameras: Sequence[str], response: str, robot: str, encoders: str, poses: str) -> None:
    """A folder in the TUM-mono layout with all optional files."""
    (folder / "images").mkdir(parents=True)
    for index in range(IMAGES):
        cv2.imwrite(str(folder / "images" / f"{index:05d}{'.jpg' if index == 1 else '.png'}"), picture(index))
    times = "".join(f"{index:05d} 1700000001.{33 * index:03d} {5 + index}\n" for index in range(IMAGES))
    cv2.imwrite(str(folder / "vignette.png"), np.full((HEIGHT, WIDTH), 200, np.uint8))
    for name, content in (
        ("times.txt", times),
        ("camera.txt", cameras[0]),
        ("pcalib.txt", response),
        ("robot.yaml", robot),
        ("encoders.csv", encoders),
        ("groundtruth.tum", poses),
    ):
        (folder / name).write_text(content)


def read_all(recording: Recording) -> object:
    """Everything that is in a recording."""
    frames = [frame for frame in recording.frames() if isinstance(frame, Frame)]
    truth = None if recording.ground_truth_path is None else read_tum(recording.ground_truth_path)
    return (
        frames,
        [recording.photometric.correct(frame.image, 256.0) for frame in frames],
        recording.calibration,
        recording.image_times(),
        recording.wheels,
        recording.robot,
        truth,
    )


class Messages(MessageWriter):
    """The messages of a short drive: (topic, stamp_ns, message) each."""

    def __init__(self) -> None:
        super().__init__()
        self.all: List[Tuple[str, int, RosMessage]] = []

    def write(self, topic: str, stamp_ns: int, content: RosMessage, latched: bool = False) -> None:
        """See MessageWriter."""
        self.all.append((topic, stamp_ns, content))


def drive_messages() -> Messages:
    """Images, raw, compressed and of realsense-viewer, camera_info, exposures, wheels, poses and transforms."""
    messages = Messages()
    K = np.array([[60.0, 0, 47.5], [0, 61.0, 39.5], [0, 0, 1]])
    messages.tf_static(stamp_ns(0), [("base_link", "mount", UP), ("mount", "optical", UP)])
    messages.write(f"{VIEWER}/option/Emitter_Enabled/value", stamp_ns(0), message("std_msgs/Float32", data=0.0))
    for index in range(IMAGES):
        at_ns = stamp_ns(index)
        messages.camera_info("/camera/up/camera_info", at_ns, "optical", (WIDTH, HEIGHT), K)
        messages.exposure("/camera/up/exposure", at_ns, "optical", 5.0 + index)
        messages.image("/camera/up/image_raw", at_ns, "optical", picture(index))
        encoded = cv2.imencode(".png", picture(index))[1].tobytes()
        messages.compressed_image(
            "/camera/small/image_raw/compressed", at_ns, "optical", encoded, "mono8; png compressed "
        )
        text = f'{{"actual_exposure":{8000 + index},"gain_level":16}}'
        of_driver = message("realsense2_camera/Metadata", header=header(at_ns, "optical"), json_data=text)
        messages.write("/camera/small/metadata", at_ns, of_driver)
        messages.image(f"{VIEWER}/Infrared_1/image/data", at_ns, "0", picture(index))
        counters = {
            "Frame Timestamp": 33_333 * index,
            "Sensor Timestamp": 33_333 * index - 4000,
            "Actual Exposure": 8000,
        }
        for key, value in counters.items():
            entry = message("diagnostic_msgs/KeyValue", key=key, value=str(value % 2**32))
            messages.write(f"{VIEWER}/Infrared_1/image/metadata", at_ns, entry)
    for index in range(8):
        at_ns, T = stamp_ns(index / 2), np.eye(4)
        T[0, 3] = 0.01 * index
        messages.joint_state(
            "/joint_states", at_ns, ["left_wheel", "right_wheel", "arm"], [0.1 * index, 0.1 * index, 0], [1, 1, 0]
        )
        messages.odometry("/odom", at_ns, "odom", "base_link", T, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0))
        messages.odometry("/odometry/filtered", at_ns, "odom", "base_link", T, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0))
        messages.pose("/visual_odometry/pose", at_ns, "vo", T)
        messages.tf(at_ns, "odom", "base_link", T)
        messages.ticks("/wheel/left/ticks", at_ns, 60 * index)
        messages.ticks("/wheel/right/ticks", at_ns + 1000, 60 * index)
    return messages


def visual_status(index: int) -> OdometryStatus:
    """What the odometry says of an image of a drive straight on; every fifth is a keyframe."""
    poses = {key: np.eye(4) for key in range(max(0, index // 5 - 4), index // 5 + 1)}
    for key, T in poses.items():
        T[0, 3] = 0.03 * key
    keyframes = tuple(
        KeyframeEstimate(key, stamp_ns(5 * key), 0, T, (0.0, 0.0), key < index // 5 - 2) for key, T in poses.items()
    )
    T_keyframe_camera = np.eye(4)
    T_keyframe_camera[0, 3] = 0.006 * (index % 5)
    return OdometryStatus(
        stamp_ns(index),
        TrackingState.TRACKING,
        0,
        poses[index // 5] @ T_keyframe_camera,
        keyframe_id=index // 5,
        T_keyframe_camera=T_keyframe_camera,
        keyframes=keyframes if index % 5 == 0 else (),
    )


def write_camera_spool(folder: Path) -> Path:
    """What dso_node leaves when it is killed."""
    spool = CameraSpool(SpoolFolder(folder, "dso_node"), 10**7)
    for index in range(SPOOLED):
        spool.add(visual_status(index))
    spool.flush()
    for name, content in spool.newest().items():
        (spool.path / name).write_bytes(content)
    return spool.path


def write_fusion_spool(folder: Path) -> Path:
    """The same of fusion_node."""
    estimator = FusionEstimator(RobotModel(np.eye(4), 0.5), FusionConfig(), keep_history=True)
    spool = FusionSpool(SpoolFolder(folder, "fusion_node"), 10**7, FusionConfig())
    for index in range(2 * SPOOLED):
        state = estimator.add_wheel_odometry(stamp_ns(index / 2), np.array([0.012 * index, 0.0, 0.0]))
        if state is not None:
            spool.add(state, estimator.wheels.total.pose)
        if index % 2 == 0:
            status = visual_status(index // 2)
            estimator.add_keyframes(status)
            estimator.add_frame(status)
    spool.add_motions(estimator.take_settled())
    spool.flush()
    for name, content in spool.newest(estimator.unsettled(), estimator.origin).items():
        (spool.path / name).write_bytes(content)
    return spool.path
