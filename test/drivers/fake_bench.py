# SPDX-License-Identifier: BSD-3-Clause
"""Plugs the cameras of stand_in/pyrealsense2.py in and out."""

import json
import struct
import time
from pathlib import Path

STAND_IN = Path(__file__).parent / "stand_in"


def now_raw_s():
    """Of the clock that the stand-in's cameras have their times by."""
    return 1e-9 * time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


def truth_of(image):
    """Number and true time of day, nanoseconds, of the middle of the exposure; and the index of its stream."""
    return (*struct.unpack("<qq", image[0, :16].tobytes()), int(image[0, 16]))


def exposure_ms_of(number):
    """Of the image with a number."""
    return 2.0 + 0.1 * (number % 50)


class FakeBench:
    """The folder that describes the cameras.

    Attributes:
        folder: for the environment's FAKE_REALSENSE.
    """

    def __init__(self, folder):
        self.folder = folder
        folder.mkdir(exist_ok=True)
        self._cameras = {}
        self._write()

    def plug_in(self, serial="1111", **fields):
        """Switch a camera on."""
        self._cameras[serial] = {"serial": serial, "on_s": now_raw_s(), **fields}
        self._write()

    def unplug(self, serial="1111"):
        """Switch it off."""
        del self._cameras[serial]
        self._write()

    def change(self, serial="1111", **fields):
        """Something happens to a camera."""
        self._cameras[serial].update(fields)
        self._write()

    def options(self, serial="1111"):
        """What the driver has set so far."""
        path = self.folder / f"options-{serial}.json"
        return json.loads(path.read_text()) if path.exists() else {}

    def _write(self):
        part = self.folder / "devices.part"
        part.write_text(json.dumps(list(self._cameras.values())))
        part.replace(self.folder / "devices.json")
