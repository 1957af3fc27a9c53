# SPDX-License-Identifier: BSD-3-Clause
"""`record`: a RealSense, and topics of ROS such as those of the wheels, into a bag."""

import argparse
import shutil
import time
from collections import Counter
from contextlib import closing
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Union
from typing import Counter as CounterType

from ceiling_dso_ros.cli.outputs import require_output_file
from ceiling_dso_ros.cli.recording_options import warn
from ceiling_dso_ros.cli.ros_topics import RosTopics
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.drivers.camera_feed import CameraFeed
    from ceiling_dso_ros.drivers.reports import Connected, Report
    from ceiling_dso_ros.drivers.settings import CameraSettings
    from ceiling_dso_ros.io.bag_writer import BagWriter, SerializedMessage

CAMERA_FRAME = "camera_up_optical_frame"
MOST_WAITING = 100  # reports that are not written yet: 40 MB of images
START_S = 30.0  # until the camera's process has said anything, on a slow computer
WAIT_S = 10.0  # for a camera after that
DISK_PERIOD_S = 1.0
GB = 1e9


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "record",
        help="record a RealSense into a bag",
        description="Record the images of a RealSense that looks up into a ROS 1 bag, with exposure times and stamps "
        "in the middle of the exposure, until Ctrl-C. Topics of ROS, such as joint_states, are recorded with them.",
    )
    parser.add_argument("--out", metavar="FILE.bag", type=Path, required=True, help="output bag")
    parser.add_argument("--duration", metavar="S", type=float, default=0.0, help="seconds (default: until Ctrl-C)")
    parser.add_argument(
        "--topic", metavar="TOPIC", dest="topics", action="append", default=[],
        help="a ROS topic to record too, such as /joint_states or /tf_static; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--keep-free", metavar="GB", type=float, default=1.0, help="end when the disk has less (default %(default)s)"
    )
    group = parser.add_argument_group("camera")
    group.add_argument("--serial-no", metavar="N", default="", help="default: the only one that is connected")
    group.add_argument("--size", metavar="WxH", default="848x480", help="pixels (default %(default)s)")
    group.add_argument("--fps", metavar="N", type=int, default=30, help="images a second (default %(default)s)")
    group.add_argument("--stereo", action="store_true", help="the right images too")
    group.add_argument("--imu", action="store_true", help="angular rates and accelerations too")
    group.add_argument("--exposure", metavar="MS", type=float, default=0.0, help="fixed time (default: automatic)")
    group.add_argument("--gain", metavar="N", type=int, default=16, help="with --exposure, 16 to 248 (default 16)")
    group.add_argument(
        "--exposure-limit", metavar="MS", type=float, default=8.0, help="longest automatic time (default 8)"
    )
    group.add_argument("--gain-limit", metavar="N", type=int, default=0, help="largest automatic gain, 16 to 248")
    group.add_argument(
        "--metering", metavar="X", type=float, default=0.6,
        help="side of the square that automatic exposure looks at, by the height; 0 for all (default 0.6)",
    )  # fmt: skip
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Record until the time is over, the disk is nearly full, or Ctrl-C; the bag is complete in all cases.

    Raises:
        InputError: wrong settings, no camera, no ROS, or a file that cannot be written.
        OutputError: the bag cannot be written; it is removed.
    """
    from ceiling_dso_ros.drivers.camera_process import CameraProcess

    settings = _settings(options)
    if not 0.0 <= options.duration < float("inf"):
        raise InputError(f"--duration {options.duration:g}: 0 or more")
    if options.out.is_file():
        raise InputError(f"{options.out}: exists already, and no recording is replaced; choose another --out")
    require_output_file(options.out)
    inbox = _Inbox()
    with closing(CameraProcess(settings, inbox.put)) as camera:
        camera.start()
        first = _await_camera(inbox)
        with closing(RosTopics(options.topics, inbox.put)):
            print(f"recording {first.camera}; end with Ctrl-C")
            _Recorder(options, inbox).record(first)


def _settings(options: argparse.Namespace) -> "CameraSettings":
    from ceiling_dso_ros.drivers.settings import CameraSettings, ExposureSettings, Mode
    from ceiling_dso_ros.io.image_scaling import parse_image_size

    width, height = parse_image_size(options.size, "--size")
    exposure = ExposureSettings(
        fixed_ms=options.exposure,
        fixed_gain=options.gain,
        limit_ms=options.exposure_limit,
        gain_limit=options.gain_limit,
        metering=options.metering,
    )
    mode = Mode(width, height, options.fps)
    settings = CameraSettings(options.serial_no, mode, options.stereo, options.imu, exposure)
    settings.check()
    return settings


class _Inbox:
    """What camera and topics deliver, until it is written.

    Attributes:
        lost: what came while the disk was too slow.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._queue: Queue[Union[Report, SerializedMessage]] = Queue(MOST_WAITING)

    def put(self, item: "Union[Report, SerializedMessage]") -> None:
        """Called from the threads that listen."""
        try:
            self._queue.put_nowait(item)
        except Full:
            self.lost += 1

    def get(self) -> "Union[Report, SerializedMessage, None]":
        """The next item; None if there is none for a while."""
        try:
            return self._queue.get(timeout=0.2)
        except Empty:
            return None


def _await_camera(inbox: _Inbox) -> "Connected":
    """The report that a camera streams.

    Raises:
        InputError: none does.
    """
    from ceiling_dso_ros.drivers.reports import Connected, Waiting

    end_s = time.monotonic() + START_S
    reason = ""
    while time.monotonic() < end_s:
        report = inbox.get()
        if isinstance(report, Connected):
            return report
        if isinstance(report, Waiting):
            end_s = end_s if reason else time.monotonic() + WAIT_S
            reason = report.message
    raise InputError(reason or "the camera does not answer")


class _Recorder:
    def __init__(self, options: argparse.Namespace, inbox: _Inbox) -> None:
        self._path, self._duration_s, self._keep_free_gb = options.out, options.duration, options.keep_free
        self._inbox = inbox
        self._images = 0
        self._of_topics: CounterType[str] = Counter()
        self._checked_s = 0.0

    def record(self, first: "Connected") -> None:
        """Write what comes.

        Raises:
            OutputError: the bag cannot be written.
        """
        from tqdm import tqdm

        from ceiling_dso_ros.drivers.camera_feed import CameraFeed
        from ceiling_dso_ros.io.bag_writer import BagWriter

        start_s = time.monotonic()
        with BagWriter(self._path) as bag, tqdm(unit="image", disable=None) as progress:
            feed = CameraFeed(bag, CAMERA_FRAME)
            try:
                self._take(first, feed, bag)
                while not self._is_over(start_s):
                    item = self._inbox.get()
                    if item is not None:
                        self._take(item, feed, bag)
                    progress.set_postfix(dropped=feed.stamper.dropped + self._inbox.lost, refresh=False)
                    progress.update(self._images - progress.n)
            except KeyboardInterrupt:  # the usual end
                pass
        print(self._describe(feed, time.monotonic() - start_s))

    def _take(self, item: "Union[Report, SerializedMessage]", feed: "CameraFeed", bag: "BagWriter") -> None:
        from ceiling_dso_ros.drivers.reports import Connected, Remark
        from ceiling_dso_ros.io.bag_writer import SerializedMessage

        if isinstance(item, SerializedMessage):
            self._of_topics[item.topic] += 1
            bag.write_serialized(item)
            return
        before = feed.waiting
        self._images += feed.take(item) is not None
        if isinstance(item, Connected):
            for complaint in item.camera.complaints:
                warn(complaint)
        elif isinstance(item, Remark):
            warn(item.message)
        elif feed.waiting and feed.waiting != before:
            warn(feed.waiting)

    def _is_over(self, start_s: float) -> bool:
        now_s = time.monotonic()
        if 0.0 < self._duration_s <= now_s - start_s:
            return True
        if now_s - self._checked_s < DISK_PERIOD_S:
            return False
        self._checked_s = now_s
        free_gb = shutil.disk_usage(self._path.resolve().parent).free / GB
        if free_gb < self._keep_free_gb:
            limit = f"--keep-free {self._keep_free_gb:g}"
            warn(f"{self._path}: the recording ends: the disk has {free_gb:.2f} GB left, {limit}")
        return free_gb < self._keep_free_gb

    def _describe(self, feed: "CameraFeed", duration_s: float) -> str:
        dropped = feed.stamper.dropped + self._inbox.lost
        parts = [f"{duration_s:.1f} s", f"{self._images} images", f"{dropped} dropped"]
        parts += [f"{count} messages of {topic}" for topic, count in self._of_topics.items()]
        return f"{self._path}: {', '.join(parts)}"
