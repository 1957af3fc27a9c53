# SPDX-License-Identifier: BSD-3-Clause
"""Finds a RealSense among those that are connected, and describes it."""

from typing import Dict, List, Optional, Set, Tuple

import numpy as np
import pyrealsense2 as rs

from ceiling_dso_ros.drivers.reports import CameraError, Lens
from ceiling_dso_ros.drivers.settings import Mode

UNKNOWN = "unknown"


def find_device(context: rs.context, serial_no: str) -> rs.device:
    """The camera with a serial number, or the only one.

    Raises:
        CameraError: it is not there, or it is not clear which one is meant.
    """
    devices = {info(device, rs.camera_info.serial_number): device for device in context.query_devices()}
    if not devices:
        raise CameraError(f"camera {serial_no} is not connected" if serial_no else "no RealSense camera is connected")
    connected = " and ".join(sorted(devices))
    if serial_no:
        if serial_no not in devices:
            raise CameraError(f"camera {serial_no} is not connected, but {connected}")
        return devices[serial_no]
    if len(devices) > 1:
        raise CameraError(f"the cameras {connected} are connected: choose one with serial_no")
    return next(iter(devices.values()))


def info(device: rs.device, kind: rs.camera_info) -> str:
    """What a device says of itself."""
    return str(device.get_info(kind)) if device.supports(kind) else UNKNOWN


def infrared_sensor(device: rs.device) -> rs.sensor:
    """The sensor that has the infrared images.

    Raises:
        CameraError: there is none.
    """
    for sensor in device.query_sensors():
        if any(profile.stream_type() == rs.stream.infrared for profile in sensor.get_stream_profiles()):
            return sensor
    raise CameraError(f"{info(device, rs.camera_info.name)} has no infrared images")


def infrared_modes(sensor: rs.sensor) -> Dict[int, Set[Mode]]:
    """Modes of grey images of 8 bits, by the index of the stream: 1 is the left one, 2 the right one."""
    modes: Dict[int, Set[Mode]] = {1: set(), 2: set()}
    for profile in sensor.get_stream_profiles():
        if profile.stream_type() == rs.stream.infrared and profile.format() == rs.format.y8:
            video = profile.as_video_stream_profile()
            modes.setdefault(profile.stream_index(), set()).add(Mode(video.width(), video.height(), profile.fps()))
    return modes


def motion_profiles(device: rs.device) -> Tuple[Optional[rs.sensor], List[rs.stream_profile]]:
    """The sensor of the inertial unit, None without one, with its fastest profiles of angular rate and acceleration."""
    for sensor in device.query_sensors():
        profiles = sensor.get_stream_profiles()
        of_kinds = [[p for p in profiles if p.stream_type() == kind] for kind in (rs.stream.gyro, rs.stream.accel)]
        if all(of_kinds):
            return sensor, [max(of_kind, key=lambda profile: profile.fps()) for of_kind in of_kinds]
    return None, []


def lens_of(profile: rs.stream_profile) -> Lens:
    """Intrinsics of a stream."""
    intrinsics = profile.as_video_stream_profile().get_intrinsics()
    K = np.array([[intrinsics.fx, 0.0, intrinsics.ppx], [0.0, intrinsics.fy, intrinsics.ppy], [0.0, 0.0, 1.0]])
    return Lens(K, tuple(float(coefficient) for coefficient in intrinsics.coeffs))


def pose_in(profile: rs.stream_profile, left: rs.stream_profile) -> np.ndarray:
    """T_left_other (4, 4) of the sensor of another stream, metres."""
    extrinsics = profile.get_extrinsics_to(left)
    T = np.eye(4)
    T[:3, :3] = np.reshape(extrinsics.rotation, (3, 3), order="F")  # the library's matrices are column-major
    T[:3, 3] = extrinsics.translation
    return T
