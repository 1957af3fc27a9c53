# SPDX-License-Identifier: BSD-3-Clause
"""Streams images and inertial readings of a RealSense, or of a recording of one."""

from contextlib import suppress
from typing import Dict, List, Optional, Tuple

import numpy as np
import pyrealsense2 as rs

from ceiling_dso_ros.drivers import realsense_controls
from ceiling_dso_ros.drivers.image_times import FrameTimes, host_time
from ceiling_dso_ros.drivers.realsense_device import (
    find_device,
    info,
    infrared_modes,
    infrared_sensor,
    lens_of,
    motion_profiles,
    pose_in,
)
from ceiling_dso_ros.drivers.reports import CameraDescription, CameraError, CapturedImages, InertialReading
from ceiling_dso_ros.drivers.settings import CameraSettings, ExposureSettings, Mode, nearest_mode

LEFT, RIGHT = 1, 2
MOTION_QUEUE = 1000  # readings, some seconds
OLD_USB = ("1", "2")


class RealsenseStream:
    """A camera that streams, from its construction until `close`.

    Attributes:
        camera: what streams.
    """

    def __init__(self, settings: CameraSettings) -> None:
        """Find the camera and start it.

        Raises:
            CameraError: there is no such camera, or it cannot be started.
        """
        self._settings = settings
        self._motion: Optional[rs.sensor] = None
        self._queue = rs.frame_queue(MOTION_QUEUE)
        # Anew each time: after a camera was unplugged or reset, an old context may still have it or crash.
        context = rs.context()
        self._pipeline = rs.pipeline(context)
        try:
            config, complaints = self._of_recording() if settings.recording else self._of_camera(context)
            self.camera = self._start(config, complaints)
        except CameraError:
            self.close()
            raise
        except RuntimeError as error:  # of the library, which may be about to lose the device
            self.close()
            raise CameraError(f"the camera cannot be started: {error}") from error

    def _of_recording(self) -> Tuple[rs.config, List[str]]:
        config = rs.config()
        config.enable_device_from_file(self._settings.recording, repeat_playback=False)
        config.enable_stream(rs.stream.infrared, LEFT)
        if self._settings.stereo:
            config.enable_stream(rs.stream.infrared, RIGHT)
        return config, []

    def _of_camera(self, context: rs.context) -> Tuple[rs.config, List[str]]:
        """The streams to start, and complaints."""
        device = find_device(context, self._settings.serial_no)
        sensor = infrared_sensor(device)
        offered = infrared_modes(sensor)
        if not offered[LEFT]:
            raise CameraError("the camera offers no grey infrared images")
        wanted = self._settings.mode
        mode = nearest_mode(offered[LEFT], wanted)
        indices = [LEFT, *([RIGHT] if self._settings.stereo and mode in offered[RIGHT] else [])]
        usb = info(device, rs.camera_info.usb_type_descriptor)
        complaints = [] if mode == wanted else [f"{mode} instead of {wanted}, which the camera does not offer"]
        if self._settings.stereo and RIGHT not in indices:
            complaints.append("there are no right images")
        if usb.startswith(OLD_USB):
            complaints.append(f"connected by USB {usb}: use a port and a cable of USB 3")
        complaints += realsense_controls.prepare(device)
        complaints += realsense_controls.expose(sensor, self._settings.exposure)
        config = rs.config()
        config.enable_device(info(device, rs.camera_info.serial_number))
        for index in indices:
            config.enable_stream(rs.stream.infrared, index, mode.width, mode.height, rs.format.y8, mode.rate_hz)
        return config, complaints

    def _start(self, config: rs.config, complaints: List[str]) -> CameraDescription:
        profile = self._pipeline.start(config)
        device = profile.get_device()
        streams = {stream.stream_index(): stream for stream in profile.get_streams()}
        left, right = streams.get(LEFT), streams.get(RIGHT)
        if left is None:
            raise CameraError("there are no left infrared images")
        video = left.as_video_stream_profile()
        mode = Mode(video.width(), video.height(), left.fps())
        self._sensor = infrared_sensor(device)
        if not self._settings.recording:
            # Again: the pipeline has objects of its own for the sensors, and the library's time is an option of those.
            realsense_controls.prepare(device)
            complaints = complaints + realsense_controls.meter(self._sensor, self._settings.exposure, mode)
        T_left_imu = None
        if self._settings.imu:
            T_left_imu = self._start_motion(device, left)
            complaints = complaints + ([] if T_left_imu is not None else ["the camera has no inertial unit"])
        has_metadata = None if self._settings.recording else _has_metadata(device)
        if has_metadata is False:
            complaints.append("no metadata: this computer's kernel does not pass on exposure times")
        return CameraDescription(
            name=info(device, rs.camera_info.name),
            serial_no=info(device, rs.camera_info.serial_number),
            firmware=info(device, rs.camera_info.firmware_version),
            usb=info(device, rs.camera_info.usb_type_descriptor),
            port=info(device, rs.camera_info.physical_port),
            mode=mode,
            left=lens_of(left),
            right=None if right is None else lens_of(right),
            T_left_right=None if right is None else pose_in(right, left),
            T_left_imu=T_left_imu,
            has_metadata=has_metadata,
            complaints=tuple(complaints),
        )

    def _start_motion(self, device: rs.device, left: rs.stream_profile) -> Optional[np.ndarray]:
        """Start the inertial unit; returns T_left_imu (4, 4), None without one."""
        sensor, profiles = motion_profiles(device)
        if sensor is None:
            return None
        sensor.open(profiles)
        self._motion = sensor
        sensor.start(self._queue)
        return pose_in(profiles[0], left)

    def capture(self, timeout_s: float) -> Optional[CapturedImages]:
        """The next images; None if none arrive in time.

        Raises:
            CameraError: the camera is gone.
        """
        try:
            has_arrived, frames = self._pipeline.try_wait_for_frames(round(1e3 * timeout_s))
        except RuntimeError as error:
            raise CameraError(f"the camera has stopped: {error}") from error
        if not has_arrived:
            return None
        arrival = host_time()
        left = frames.get_infrared_frame(LEFT)
        if not left:
            return None
        known = metadata_of(left)
        others = [frames.get_infrared_frame(RIGHT)] if self.camera.right is not None else []
        if not all(others):  # a right image alone is missing: dropped as a pair
            return None
        return CapturedImages(
            images=tuple(np.array(frame.get_data()) for frame in (left, *others)),  # copies: the library reuses them
            times=frame_times(left, known),
            number=known.get("frame_counter", left.get_frame_number()),
            arrival=arrival,
            gain=known.get("gain_level"),
        )

    def readings(self) -> Tuple[InertialReading, ...]:
        """All inertial readings since the last call."""
        readings = []
        while self._motion is not None and (frame := self._queue.poll_for_frame()):
            vector = frame.as_motion_frame().get_motion_data()
            is_rate = frame.get_profile().stream_type() == rs.stream.gyro
            readings.append(
                InertialReading(round(1e3 * frame.get_timestamp()), is_rate, (vector.x, vector.y, vector.z))
            )
        return tuple(readings)

    def expose(self, exposure: ExposureSettings) -> List[str]:
        """Expose in another way at once, as far as the camera can; returns complaints."""
        if self._settings.recording:
            return ["a recording cannot be exposed anew"]
        complaints = realsense_controls.expose(self._sensor, exposure)
        return complaints + realsense_controls.meter(self._sensor, exposure, self.camera.mode)

    def require_connected(self) -> None:
        """Raise CameraError if the camera is no longer connected."""
        if not self._settings.recording:
            try:
                find_device(rs.context(), self.camera.serial_no)
            except RuntimeError as error:
                raise CameraError(f"the connected cameras cannot be listed: {error}") from error

    def reset(self) -> None:
        """Restart the camera itself; the stream is over.

        Raises:
            CameraError: it does not react.
        """
        try:
            find_device(rs.context(), self.camera.serial_no).hardware_reset()
        except RuntimeError as error:
            raise CameraError(f"the camera cannot be reset: {error}") from error

    def close(self) -> None:
        """Stop streaming, as far as the camera is still there."""
        with suppress(RuntimeError):
            if self._motion is not None:
                self._motion.stop()
                self._motion.close()
        with suppress(RuntimeError):
            self._pipeline.stop()


def _has_metadata(device: rs.device) -> Optional[bool]:
    try:
        return bool(device.is_metadata_enabled())
    except (AttributeError, RuntimeError):  # not all devices can say
        return None


METADATA = ("frame_counter", "frame_timestamp", "sensor_timestamp", "actual_exposure", "gain_level")


def metadata_of(frame: rs.frame) -> Dict[str, int]:
    """What there is of it."""
    kinds = {name: getattr(rs.frame_metadata_value, name) for name in METADATA}
    return {name: frame.get_frame_metadata(kind) for name, kind in kinds.items() if frame.supports_frame_metadata(kind)}


def frame_times(frame: rs.frame, known: Dict[str, int]) -> FrameTimes:
    """When a frame was taken, by the device's counter if it is known; `known` is the frame's metadata."""
    readout_us = known.get("frame_timestamp")
    of_device = frame.get_frame_timestamp_domain() == rs.timestamp_domain.hardware_clock
    return FrameTimes(
        timestamp_ms=frame.get_timestamp() if readout_us is None else 1e-3 * readout_us,
        of_device=of_device or readout_us is not None,
        readout_us=readout_us,
        middle_us=known.get("sensor_timestamp"),
        exposure_us=known.get("actual_exposure"),
    )
