# SPDX-License-Identifier: BSD-3-Clause
"""Writes recordings with the library's own recorder, from a software device."""

import time

import numpy as np
import pyrealsense2 as rs

SERIAL_NO = "0123456789"


def intrinsics_of(lens):
    """Of a pinhole lens of this package."""
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = lens.width, lens.height
    intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy = lens.fx, lens.fy, lens.cx, lens.cy
    intrinsics.model = rs.distortion.brown_conrady
    intrinsics.coeffs = [0.0] * 5
    return intrinsics


def video_stream(lens, rate_hz, index):
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid = rs.stream.infrared, index, index
    stream.width, stream.height, stream.fps, stream.bpp = lens.width, lens.height, rate_hz, 1
    stream.fmt, stream.intrinsics = rs.format.y8, intrinsics_of(lens)
    return stream


class SoftwareCamera:
    """A software device with one or two infrared streams.

    Attributes:
        device: of the library.
        sensor: its only one.
        profiles: of its streams.
    """

    def __init__(self, lens, rate_hz=30, indices=(1,)):
        self.device = rs.software_device()
        self.device.register_info(rs.camera_info.name, "Intel RealSense D455")
        self.device.register_info(rs.camera_info.serial_number, SERIAL_NO)
        self.sensor = self.device.add_sensor("Stereo Module")
        self.profiles = [self.sensor.add_video_stream(video_stream(lens, rate_hz, index)) for index in indices]

    def send(self, number, readout_us, exposure_us, images, domain=rs.timestamp_domain.hardware_clock, metadata=True):
        """Deliver the images of one moment; stamps are floats in milliseconds."""
        if metadata:
            values = {
                "frame_counter": number,
                "frame_timestamp": round(readout_us) % 2**32,
                "sensor_timestamp": round(readout_us - exposure_us / 2) % 2**32,
                "actual_exposure": round(exposure_us),
                "gain_level": 16,
            }
            for name, value in values.items():
                self.sensor.set_metadata(getattr(rs.frame_metadata_value, name), value)
        for profile, image in zip(self.profiles, images):
            frame = rs.software_video_frame()
            frame.profile = profile.as_video_stream_profile()
            frame.stride, frame.bpp = image.shape[1], 1
            frame.timestamp, frame.domain, frame.frame_number = readout_us / 1000, domain, number
            frame.pixels = np.ascontiguousarray(image)
            self.sensor.on_video_frame(frame)


def record(path, lens, moments, rate_hz):
    """Write a recording.

    Args:
        path: of the bag.
        lens: pinhole.
        moments: (readout in microseconds, exposure in microseconds, image) of each.
        rate_hz: of the stream; the images are delivered at this rate.
    """
    camera = SoftwareCamera(lens, rate_hz)
    recorder = rs.recorder(str(path), camera.device)
    (sensor,) = recorder.query_sensors()
    queue = rs.frame_queue(1)
    sensor.open(sensor.get_stream_profiles()[0])
    sensor.start(queue)
    for number, (readout_us, exposure_us, image) in enumerate(moments):
        camera.send(number, readout_us, exposure_us, [image])
        time.sleep(1.0 / rate_hz)
    time.sleep(0.5)
    sensor.stop()
    sensor.close()
