# SPDX-License-Identifier: BSD-3-Clause
"""From the reports of a streaming process to messages: what the node and the command `record` have in common."""

import time
from typing import Optional

from ceiling_dso_ros.drivers.camera_messages import CameraMessages
from ceiling_dso_ros.drivers.inertial import InertialPairs
from ceiling_dso_ros.drivers.reports import (
    CameraDescription,
    CapturedImages,
    Connected,
    InertialReadings,
    Report,
    Waiting,
)
from ceiling_dso_ros.drivers.stamping import ImageStamper, StampedImages
from ceiling_dso_ros.io.message_writer import MessageWriter


class CameraFeed:
    """Stamps and writes what a camera delivers.

    Attributes:
        camera: that streams; None while there is none.
        waiting: why there are no images, empty while they come.
        stamper: counts images.
        newest: the last images that were written; None before the first.
        gain: of the newest images; None if unknown.
    """

    def __init__(self, writer: MessageWriter, camera_frame: str) -> None:
        """Prepare it; see `CameraMessages`."""
        self.camera: Optional[CameraDescription] = None
        self.waiting = "the streaming process begins"
        self.stamper = ImageStamper()
        self.newest: Optional[StampedImages] = None
        self.gain: Optional[int] = None
        self._messages = CameraMessages(writer, camera_frame)
        self._pairs = InertialPairs()

    def take(self, report: Report) -> Optional[StampedImages]:
        """Take a report of the streaming process; returns images if it has some that were written.

        Raises:
            OutputError: a bag cannot be written.
        """
        if isinstance(report, Waiting):
            self.waiting = report.message
        elif isinstance(report, Connected):
            self.camera, self.waiting = report.camera, ""
            self.stamper.connected()
            self._pairs = InertialPairs()
            self._messages.write_camera(time.time_ns(), report.camera)
        elif isinstance(report, CapturedImages):
            self.waiting, self.gain = "", report.gain
            return self._write(self.stamper.stamp(report))
        elif isinstance(report, InertialReadings):
            for reading in report.readings:
                for sample in self._pairs.add(reading):
                    if self.stamper.clock.is_settled:
                        self._messages.write_inertial(self.stamper.host_ns(sample.counter_us), sample)
        return None

    def _write(self, stamped: Optional[StampedImages]) -> Optional[StampedImages]:
        if stamped is not None:
            self.newest = stamped
            self._messages.write_images(stamped)
        return stamped
