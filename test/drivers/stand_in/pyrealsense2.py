# SPDX-License-Identifier: BSD-3-Clause
# ruff: noqa: N801
"""What the driver uses of pyrealsense2, for cameras that are described by a file, which may change at any time.

The folder that the environment's FAKE_REALSENSE names has `devices.json`, a list with the fields of `Camera` for each
camera that is plugged in. `options-SERIAL.json` in it gets all options that were set. Frame k of a camera is taken
k / rate after its power was switched on; its first 16 pixels are k and the true time of day of the middle of its
exposure, nanoseconds.
"""

import enum
import json
import os
import random
import struct
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, List

import numpy as np

FOLDER = Path(os.environ["FAKE_REALSENSE"])
COUNTER_US = 2**32
BASELINE_M = 0.095


def enumeration(name, *members):
    return enum.Enum(name, {member: index for index, member in enumerate(members)})


stream = enumeration("stream", "infrared", "gyro", "accel", "depth")
format = enumeration("format", "y8", "y16", "motion_xyz32f")
timestamp_domain = enumeration("timestamp_domain", "hardware_clock", "system_time", "global_time")
camera_info = enumeration(
    "camera_info", "name", "serial_number", "firmware_version", "usb_type_descriptor", "physical_port"
)
frame_metadata_value = enumeration(
    "frame_metadata_value", "frame_counter", "frame_timestamp", "sensor_timestamp", "actual_exposure", "gain_level"
)
RANGES = {
    "emitter_enabled": (0.0, 2.0),
    "global_time_enabled": (0.0, 1.0),
    "enable_auto_exposure": (0.0, 1.0),
    "exposure": (1.0, 165000.0),
    "gain": (16.0, 248.0),
    "auto_exposure_limit": (1.0, 165000.0),
    "auto_gain_limit": (16.0, 248.0),
    "auto_exposure_limit_toggle": (0.0, 1.0),
    "auto_gain_limit_toggle": (0.0, 1.0),
}
option = enumeration("option", *RANGES)


@dataclass
class Camera:
    """A camera that is plugged in.

    Attributes:
        on_s: when its power was switched on, seconds of CLOCK_MONOTONIC_RAW.
        counter_us: of its counter at that moment.
        drift_ppm: by how much its counter is faster than this computer's clock.
        step_us: that its counter was set forward since, or backward.
        delay_ms, jitter_ms: from the start of the readout to the arrival of an image; the jitter is between 0 and this.
        starting_s: that it takes to begin to stream.
        trouble: hang, silent, crash, refuse: what happens while it streams, or instead of that.
        drive: file with images, exposures_ms and times_s after on_s, that are shown instead of a pattern.
    """

    serial: str
    on_s: float = 0.0
    name: str = "Intel RealSense D455"
    port: str = "2-1"
    usb: str = "3.2"
    metadata: bool = True
    modes: List[List[int]] = field(
        default_factory=lambda: [[848, 480, 30], [424, 240, 30], [424, 240, 90], [640, 480, 15]]
    )
    counter_us: int = 0
    drift_ppm: float = 0.0
    step_us: int = 0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    starting_s: float = 0.0
    trouble: str = ""
    has_motion: bool = True
    drive: str = ""

    def counter(self, raw_s):
        """Its counter at a time of this computer's clock."""
        elapsed_us = (raw_s - self.on_s) * (1e6 + self.drift_ppm)
        return (self.counter_us + self.step_us + round(elapsed_us)) % COUNTER_US


class Bench:
    """The cameras that are plugged in now."""

    def __init__(self):
        self._read_ns, self._cameras = -1, {}

    def cameras(self) -> Dict[str, Camera]:
        path = FOLDER / "devices.json"
        try:
            changed_ns = path.stat().st_mtime_ns
        except FileNotFoundError:  # nothing was plugged in yet
            return {}
        if changed_ns != self._read_ns:
            self._cameras = {each["serial"]: Camera(**each) for each in json.loads(path.read_text())}
            self._read_ns = changed_ns
        return self._cameras

    def camera(self, serial) -> Camera:
        """Raises RuntimeError: it was unplugged."""
        try:
            return self.cameras()[serial]
        except KeyError:
            raise RuntimeError("xioctl(VIDIOC_QBUF) failed, errno=19 No such device") from None


BENCH = Bench()


def raw_s():
    return 1e-9 * time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


class Profile:
    def __init__(self, kind, index, mode):
        self._kind, self._index, self._mode = kind, index, mode

    def stream_type(self):
        return self._kind

    def stream_index(self):
        return self._index

    def format(self):
        return format.y8 if self._kind is stream.infrared else format.motion_xyz32f

    def fps(self):
        return self._mode[2]

    def as_video_stream_profile(self):
        return self

    def width(self):
        return self._mode[0]

    def height(self):
        return self._mode[1]

    def get_intrinsics(self):
        width, height, _ = self._mode
        focal_px = 425.3 * width / 848
        # The simulator's camera.
        return SimpleNamespace(
            fx=focal_px, fy=focal_px, ppx=(width - 1) / 2 + 2.4 * width / 848, ppy=(height - 1) / 2 - 1.3 * width / 848,
            coeffs=[0.0] * 5,
        )  # fmt: skip

    def get_extrinsics_to(self, _left):
        translation = {1: [0.0] * 3, 2: [BASELINE_M, 0.0, 0.0]}.get(self._index, [0.03, 0.007, 0.016])
        return SimpleNamespace(rotation=np.eye(3).ravel(order="F").tolist(), translation=translation)


class Sensor:
    def __init__(self, serial, kinds):
        self._serial, self._kinds = serial, kinds

    def get_stream_profiles(self):
        camera = BENCH.camera(self._serial)
        if stream.infrared not in self._kinds:
            return [Profile(stream.gyro, 0, (0, 0, 200)), Profile(stream.accel, 0, (0, 0, 100))]
        indices = (1,) if camera.usb.startswith("2") else (1, 2)
        return [Profile(stream.infrared, index, mode) for index in indices for mode in camera.modes]

    def supports(self, wanted):
        BENCH.camera(self._serial)
        return stream.infrared in self._kinds and wanted.name in RANGES

    def get_option_range(self, wanted):
        smallest, largest = RANGES[wanted.name]
        return SimpleNamespace(min=smallest, max=largest, step=1.0, default=smallest)

    def set_option(self, wanted, value):
        smallest, largest = RANGES[wanted.name]
        if not smallest <= value <= largest:
            raise RuntimeError(f"set_option({wanted.name}): out of range")
        self._note(wanted.name, value)

    def is_roi_sensor(self):
        return True

    def as_roi_sensor(self):
        return self

    def set_region_of_interest(self, region):
        self._note("region", [region.min_x, region.max_x, region.min_y, region.max_y])

    def _note(self, name, value):
        path = FOLDER / f"options-{self._serial}.json"
        known = json.loads(path.read_text()) if path.exists() else {}
        known[name] = value
        part = path.with_suffix(f".{os.getpid()}")  # several drivers may set options of one camera
        part.write_text(json.dumps(known))
        part.replace(path)

    # Of the inertial unit.

    def open(self, _profiles):
        pass

    def start(self, queue):
        queue.sensor_of(self._serial)

    def stop(self):
        pass

    def close(self):
        pass


class device:
    def __init__(self, serial):
        self._serial = serial

    def supports(self, _kind):
        return True

    def get_info(self, kind):
        camera = BENCH.camera(self._serial)
        return {
            "name": camera.name,
            "serial_number": camera.serial,
            "firmware_version": "5.16.0.1",
            "usb_type_descriptor": camera.usb,
            "physical_port": camera.port,
        }[kind.name]

    def query_sensors(self):
        infrared = Sensor(self._serial, {stream.infrared, stream.depth})
        return [infrared, *([Sensor(self._serial, {stream.gyro})] if BENCH.camera(self._serial).has_motion else [])]

    def is_metadata_enabled(self):
        return BENCH.camera(self._serial).metadata

    def hardware_reset(self):
        (FOLDER / "reset").write_text(self._serial)


class context:
    def query_devices(self):
        return [device(serial) for serial in BENCH.cameras()]


class region_of_interest:
    min_x = max_x = min_y = max_y = 0


class config:
    def __init__(self):
        self.serial, self.streams = "", {}

    def enable_device(self, serial):
        self.serial = serial

    def enable_stream(self, _kind, index, width, height, _format, rate_hz):
        self.streams[index] = (width, height, rate_hz)


class Frame:
    def __init__(self, data, camera, number, readout_s, exposure_ms, arrival_s):
        self._data, self._camera, self._number = data, camera, number
        self._readout_s, self._exposure_ms, self._arrival_s = readout_s, exposure_ms, arrival_s

    def get_data(self):
        return self._data

    def get_timestamp(self):
        if self._camera.metadata:
            return 1e-3 * self._camera.counter(self._readout_s)
        return 1e3 * (self._arrival_s + time.time() - raw_s())

    def get_frame_timestamp_domain(self):
        return timestamp_domain.hardware_clock if self._camera.metadata else timestamp_domain.system_time

    def get_frame_number(self):
        return self._number

    def supports_frame_metadata(self, _kind):
        return self._camera.metadata

    def get_frame_metadata(self, kind):
        return {
            "frame_counter": self._number,
            "frame_timestamp": self._camera.counter(self._readout_s),
            "sensor_timestamp": self._camera.counter(self._readout_s - 5e-4 * self._exposure_ms),
            "actual_exposure": round(1e3 * self._exposure_ms),
            "gain_level": 16,
        }[kind.name]


class Frames:
    def __init__(self, frames):
        self._frames = frames

    def get_infrared_frame(self, index):
        return self._frames[index]


class pipeline:
    def __init__(self, _context):
        self._streams: Dict[int, Any] = {}

    def start(self, wanted):
        camera = BENCH.camera(wanted.serial)
        if camera.trouble == "refuse":
            raise RuntimeError("Couldn't resolve requests")
        time.sleep(camera.starting_s)
        self._serial, self._streams = wanted.serial, wanted.streams
        self._number = -1
        self._source = Drive(camera) if camera.drive else Pattern(wanted.streams[1])
        profiles = [Profile(stream.infrared, index, mode) for index, mode in wanted.streams.items()]
        return SimpleNamespace(get_device=lambda: device(wanted.serial), get_streams=lambda: profiles)

    def try_wait_for_frames(self, timeout_ms):
        end_s = raw_s() + 1e-3 * timeout_ms
        while True:
            camera = BENCH.cameras().get(self._serial)
            if camera is not None and camera.trouble == "crash":
                os.abort()
            while camera is not None and camera.trouble == "hang":
                time.sleep(0.01)
                camera = BENCH.cameras().get(self._serial, camera)
            frames = None if camera is None or camera.trouble else self._next(camera, end_s)
            if frames is not None:
                return True, frames
            if raw_s() >= end_s:
                return False, Frames({})
            time.sleep(0.001)

    def _next(self, camera, end_s):
        """The next frames once they have arrived; of several only the last, as the library keeps one."""
        number = self._source.newest(camera, raw_s() - 1e-3 * camera.delay_ms, self._number)
        middle_s, exposure_ms = self._source.moment(camera, number)
        readout_s = middle_s + 5e-4 * exposure_ms
        jitter_ms = random.Random(number).uniform(0.0, camera.jitter_ms)
        arrival_s = readout_s + 1e-3 * (camera.delay_ms + jitter_ms)
        if arrival_s > end_s:
            time.sleep(max(0.0, end_s - raw_s()))
            return None
        time.sleep(max(0.0, arrival_s - raw_s()))
        self._number = number
        true_ns = round(1e9 * middle_s) + time.time_ns() - time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        return Frames(
            {
                index: Frame(
                    self._source.image(number, true_ns, index), camera, number, readout_s, exposure_ms, arrival_s
                )
                for index in self._streams
            }
        )

    def stop(self):
        self._streams = {}


class Pattern:
    """Frames at a constant rate, each with another exposure time; the first pixels tell number and true time."""

    def __init__(self, mode):
        self._width, self._height, self._rate_hz = mode
        self._image = np.random.default_rng(0).integers(0, 256, (self._height, self._width)).astype(np.uint8)

    def newest(self, camera, now_s, last):
        arrived = int((now_s - camera.on_s - 0.01) * self._rate_hz)
        return max(last + 1, arrived)

    def moment(self, camera, number):
        return camera.on_s + number / self._rate_hz, 2.0 + 0.1 * (number % 50)

    def image(self, number, true_ns, index):
        image = self._image.copy()
        image[0, :16] = np.frombuffer(struct.pack("<qq", number, true_ns), np.uint8)
        image[0, 16] = index
        return image


class Drive:
    """Frames of a file, once."""

    def __init__(self, camera):
        with np.load(camera.drive) as content:
            self._images, self._exposures_ms, self._times_s = (
                content[name] for name in ("images", "exposures_ms", "times_s")
            )

    def newest(self, camera, now_s, last):
        arrived = int(np.searchsorted(self._times_s, now_s - camera.on_s - 0.01)) - 1
        return max(last + 1, arrived)

    def moment(self, camera, number):
        if number >= len(self._times_s):
            return camera.on_s + 1e9, 1.0
        return camera.on_s + self._times_s[number], float(self._exposures_ms[number])

    def image(self, number, _true_ns, _index):
        return self._images[number]


class frame_queue:
    """Of the inertial unit: rates at 200 Hz, accelerations at 100 Hz, since the last poll."""

    def __init__(self, _capacity):
        self._serial = None

    def sensor_of(self, serial):
        self._serial, self._next = serial, round(200 * raw_s())
        self._waiting = []

    def poll_for_frame(self):
        camera = BENCH.cameras().get(self._serial)
        if camera is None or camera.trouble:
            return None
        while self._next < 200 * (raw_s() - 0.002):
            kinds = (stream.gyro, stream.accel) if self._next % 2 == 0 else (stream.gyro,)
            self._waiting += [Motion(kind, camera.counter(self._next / 200), self._next) for kind in kinds]
            self._next += 1
        return self._waiting.pop(0) if self._waiting else None


class Motion:
    def __init__(self, kind, counter_us, tick):
        self._kind, self._counter_us, self._tick = kind, counter_us, tick

    def get_timestamp(self):
        return 1e-3 * self._counter_us

    def get_profile(self):
        return SimpleNamespace(stream_type=lambda: self._kind)

    def as_motion_frame(self):
        return self

    def get_motion_data(self):
        # The acceleration along x is the time in seconds, modulo 100, so that its interpolation can be seen.
        x = self._tick / 200 % 100 if self._kind is stream.accel else 0.1
        return SimpleNamespace(x=x, y=0.0, z=-9.81)


# As the library names them, for annotations.
sensor, stream_profile, frame = Sensor, Profile, Frame
