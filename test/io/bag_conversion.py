# SPDX-License-Identifier: BSD-3-Clause
"""Turns any recording into a ROS 1 bag."""

from functools import partial
from heapq import merge
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, Optional, Tuple, Union

import numpy as np

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.camera_info import calibration_from_camera_info
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.recording import Recording, TopicNames, WheelSamples, WheelUnit

BASE_FRAME, CAMERA_FRAME = "base_link", "camera_up_optical_frame"

Event = Tuple[int, Callable[[], None]]  # stamp_ns, and what writes its messages


def write_recording_as_bag(recording: Recording, path: Union[str, Path], topics: TopicNames = TopicNames()) -> None:
    """Write images (uncompressed), exposures, camera_info, wheels and /tf_static; all stamps stay exact.

    Images that cannot be read are left out. A bag has no place for a photometric calibration, for a FOV lens, and for
    an output camera other than that of `crop` in the input's size: without a camera_info it is read with a camera.txt.

    Raises:
        InputError: the recording cannot be read.
        OutputError: the bag cannot be written.
    """
    with BagWriter(path) as bag:
        events = merge(
            _image_events(recording, bag, topics),
            _wheel_events(recording.wheels, bag, topics),
            key=lambda event: event[0],
        )
        for number, (stamp_ns, write) in enumerate(events):
            if number == 0 and recording.robot is not None:
                bag.tf_static(stamp_ns, [(BASE_FRAME, CAMERA_FRAME, recording.robot.T_base_camera)])
            write()


def _image_events(recording: Recording, bag: BagWriter, topics: TopicNames) -> Iterator[Event]:
    info_topic = topics.camera_info or topics.beside_image("camera_info")
    exposure_topic = topics.exposure or topics.beside_image("exposure")
    info = _camera_info(recording.calibration)
    for listed in recording.images():
        stamp_ns = listed.stamp_ns
        if stamp_ns is None:  # its message cannot be read
            continue
        try:
            image = listed.decode()
        except FrameError:
            continue
        if info is not None:
            yield stamp_ns, partial(bag.camera_info, info_topic, stamp_ns, CAMERA_FRAME, **info)
        if listed.exposure_ms is not None:
            yield stamp_ns, partial(bag.exposure, exposure_topic, stamp_ns, CAMERA_FRAME, listed.exposure_ms)
        yield stamp_ns, partial(bag.image, topics.image, stamp_ns, CAMERA_FRAME, image)


def _wheel_events(wheels: Optional[WheelSamples], bag: BagWriter, topics: TopicNames) -> Iterator[Event]:
    if wheels is None:
        return
    joints = [topics.left_joint or "left_wheel", topics.right_joint or "right_wheel"]
    for stamp_ns, *reading in wheels:
        if wheels.unit is WheelUnit.RADIANS:
            yield stamp_ns, partial(bag.joint_state, topics.joint_states, stamp_ns, joints, reading)
        elif wheels.unit is WheelUnit.POSES:
            frames, T = ("odom", topics.base_frame), _lifted(*reading)
            yield stamp_ns, partial(bag.odometry, topics.wheel_odometry, stamp_ns, *frames, T, np.zeros(3), np.zeros(3))
        else:
            for topic, ticks in zip((topics.left_ticks, topics.right_ticks), reading):
                yield stamp_ns, partial(bag.ticks, topic, stamp_ns, ticks)


def _lifted(pose: np.ndarray) -> np.ndarray:
    """(4, 4) of (3,) x, y, yaw."""
    x, y, yaw = pose.tolist()
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:2, 3] = x, y
    return T


def _camera_info(calibration: CameraCalibration) -> Optional[Dict[str, Any]]:
    """Arguments of BagWriter.camera_info, None where they would not give the same calibration back."""
    lens = calibration.lens
    distortion, model = list(lens.distortion), "plumb_bob"
    if lens.model == "EquiDistant":
        model = "equidistant"
    elif len(distortion) == 8:
        model = "rational_polynomial"
    else:
        distortion += [0.0] * (5 - len(distortion))
    read = calibration_from_camera_info(lens.width, lens.height, model, distortion, lens.matrix)
    if lens.model == "FOV" or read.camera != calibration.camera:
        return None
    return {"size": (lens.width, lens.height), "K": lens.matrix, "distortion": distortion, "distortion_model": model}
