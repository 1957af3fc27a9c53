# SPDX-License-Identifier: BSD-3-Clause
"""A robot that drives in real time and publishes what its sensors say; what it says can be falsified on the way."""

import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from typing import Callable, Dict, Iterable, Iterator, List, Optional, Tuple, TypeVar

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import Transform, TransformStamped, Vector3
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Header
from support.faults.drive import Angles, Drive, Picture, Sample

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.msg import Exposure
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time

AnySample = TypeVar("AnySample", Picture, Angles)
PictureHook = Callable[[Picture], Iterable[Picture]]
AnglesHook = Callable[[Angles], Iterable[Angles]]
CAMERA_FRAME = "camera_up_optical_frame"
STANDING_HZ, WHEELS_PER_PICTURE = 50, 3
NOISE_GREY = 1.5  # of the pixels while the robot stands, grey levels
SIMULATED_START_NS = 1_000_000_000_000


def unchanged(sample: AnySample) -> Iterable[AnySample]:
    """A hook that does nothing."""
    return (sample,)


def silent(_: AnySample) -> Iterable[AnySample]:
    """A hook that sends nothing."""
    return ()


class LiveRobot:
    """Publishes a drive's samples when they are due, in a thread.

    Attributes:
        standing: the robot stops where it is: the same picture with other noise, the wheels at rest.
        publishes_info: whether camera_info goes with every picture.
        sent: (3,) true pose at each stamp that was sent, nanoseconds.
        sent_s: monotonic time at which it was sent.
        start: true pose at the first wheel sample, (3,).
        rate: seconds of the drive in a second; may be changed.
    """

    def __init__(self, drive: Drive, simulated_clock: bool, mount: bool, rate: float = 1.0) -> None:
        """Connect, and publish the camera's mount if it is wanted.

        Args:
            drive: what the sensors say.
            simulated_clock: publish /clock.
            mount: publish the camera's mount at once.
            rate: seconds of the simulated clock in a second.
        """
        self.standing, self.publishes_info = False, True
        self.sent: Dict[int, np.ndarray] = {}
        self.sent_s: Dict[int, float] = {}
        self.start = drive.pose(next(iter(drive)).time_s)
        self.camera_info = _camera_info(drive)
        self.rate = rate
        self._drive, self._noise = drive, np.random.default_rng(0)
        self._on_picture: PictureHook = unchanged
        self._on_angles: AnglesHook = unchanged
        self._usual_angles: AnglesHook = unchanged
        self._clock = rospy.Publisher("/clock", Clock, queue_size=100) if simulated_clock else None
        self._clock_shift_ns, self._paused_s, self._is_paused = 0, 0.0, False
        self._images = rospy.Publisher("camera/up/image_raw", Image, queue_size=100)
        self._infos = rospy.Publisher("camera/up/camera_info", CameraInfo, queue_size=100)
        self._exposures = rospy.Publisher("camera/up/exposure", Exposure, queue_size=100)
        self._joints = rospy.Publisher("joint_states", JointState, queue_size=100)
        self._mounts = tf2_ros.StaticTransformBroadcaster()
        if mount:
            self.send_mount()
        self._last: Dict[type, Sample] = {}
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> "LiveRobot":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    @property
    def driven_s(self) -> float:
        """Time of the drive that has been reached, seconds."""
        return max((sample.time_s for sample in self._last.values()), default=0.0)

    def forget(self) -> None:
        """Forget what was sent so far."""
        self.sent, self.sent_s = {}, {}

    def is_heard(self) -> bool:
        """Whether the nodes are connected."""
        return all(p.get_num_connections() > 0 for p in (self._images, self._exposures, self._joints))

    @contextmanager
    def camera(self, hook: PictureHook) -> Iterator[None]:
        """While the block lasts, the hook decides what is sent of a picture."""
        self._on_picture = hook
        try:
            yield
        finally:
            self._on_picture = unchanged

    @contextmanager
    def wheels(self, hook: AnglesHook) -> Iterator[None]:
        """While the block lasts, the hook decides what is sent of a wheel sample."""
        self._on_angles = hook
        try:
            yield
        finally:
            self._on_angles = self._usual_angles

    def keep_wheels(self, hook: AnglesHook) -> None:
        """From now on the hook decides what is sent of a wheel sample."""
        self._usual_angles = self._on_angles = hook

    def send_mount(self, T_base_camera: Optional[np.ndarray] = None) -> None:
        """Publish the camera's mount to /tf_static."""
        T = self._drive.T_base_camera if T_base_camera is None else T_base_camera
        pose = pose_from_matrix(T)
        transform = TransformStamped(Header(frame_id="base_link"), CAMERA_FRAME, Transform(rotation=pose.orientation))
        transform.transform.translation = Vector3(pose.position.x, pose.position.y, pose.position.z)
        self._mounts.sendTransform([transform])

    def send_info(self, info: CameraInfo) -> None:
        """Publish any camera_info."""
        self._infos.publish(info)

    def shift_simulated_clock(self, nanoseconds_: int) -> None:
        """Set /clock and all further stamps forward or back."""
        self._clock_shift_ns += nanoseconds_

    @contextmanager
    def paused(self) -> Iterator[None]:
        """While the block lasts the simulated time, and with it the robot, stands still."""
        self._is_paused = True
        try:
            yield
        finally:
            self._is_paused = False

    def _work(self) -> None:
        self._begin_s, rate = time.monotonic(), self.rate
        for due_s, sample in self._samples():
            if rate != self.rate:  # from now on
                self._begin_s += due_s / rate - due_s / self.rate
                rate = self.rate
            while self._is_paused:
                time.sleep(0.01)
                self._paused_s = time.monotonic() - self._begin_s - due_s / self.rate
            if self._end.wait(max(0.0, self._begin_s + self._paused_s + due_s / self.rate - time.monotonic())):
                return
            self._send(due_s, sample)

    def _samples(self) -> Iterator[Tuple[float, Sample]]:
        """Samples and when they are due, seconds since the beginning; after the drive the robot stands."""
        stood_s = 0.0
        for sample in self._drive:
            while self.standing:
                for again in self._standing_samples():
                    yield stood_s + sample.time_s, again
                stood_s += 1.0 / STANDING_HZ
            self._last[type(sample)] = sample
            yield stood_s + sample.time_s, sample
        for tick in range(10**9):
            for again in self._standing_samples():
                yield stood_s + sample.time_s + tick / STANDING_HZ, again

    def _standing_samples(self) -> List[Sample]:
        picture, angles = self._last[Picture], self._last[Angles]
        assert isinstance(picture, Picture)
        if self._noise.integers(WHEELS_PER_PICTURE):
            return [angles]
        noise = NOISE_GREY * self._noise.standard_normal(picture.pixels.shape)
        return [angles, picture.showing(picture.pixels + np.rint(noise))]

    def _send(self, due_s: float, sample: Sample) -> None:
        late_ns = nanoseconds(time.monotonic() - self._begin_s - self._paused_s - due_s / self.rate)
        stamp_ns = time.time_ns() - late_ns
        if self._clock is not None:
            stamp_ns = SIMULATED_START_NS + nanoseconds(due_s) + self._clock_shift_ns
            self._clock.publish(Clock(ros_time(stamp_ns)))
        hook = self._on_picture if isinstance(sample, Picture) else self._on_angles
        for falsified in hook(sample):  # type: ignore[arg-type]
            own_ns = stamp_ns + nanoseconds(falsified.time_s - sample.time_s) + falsified.later_ns
            self.sent[own_ns], self.sent_s[own_ns] = self._drive.pose(falsified.time_s), time.monotonic()
            self._publish(own_ns, falsified)

    def _publish(self, stamp_ns: int, sample: Sample) -> None:
        header = Header(stamp=ros_time(stamp_ns) if stamp_ns > 0 else rospy.Time(), frame_id=CAMERA_FRAME)
        if isinstance(sample, Angles):
            self._joints.publish(JointState(header, sample.names, list(sample.radians), [], []))
            return
        if self.publishes_info:
            self._infos.publish(replace_header(self.camera_info, header))
        if sample.exposure_ms is not None:
            self._exposures.publish(Exposure(header, sample.exposure_ms))
        data = sample.pixels.tobytes()
        height, width = sample.pixels.shape
        kept = data[: len(data) - sample.missing_bytes]
        self._images.publish(Image(header, height, width, sample.encoding, 0, width, kept))


def replace_header(info: CameraInfo, header: Header) -> CameraInfo:
    """A camera_info with another header."""
    fields = {name: getattr(info, name) for name in ("height", "width", "distortion_model", "D", "K", "R", "P")}
    return CameraInfo(header=header, **fields)


def with_exposure(picture: Picture, exposure_ms: Optional[float]) -> Picture:
    """The same picture with another exposure."""
    return replace(picture, exposure_ms=exposure_ms)


def _camera_info(drive: Drive) -> CameraInfo:
    lens = drive.lens
    K = lens.matrix.ravel().tolist()
    D = [*lens.distortion, 0.0] if lens.distortion else [0.0] * 5
    return CameraInfo(height=lens.height, width=lens.width, distortion_model="plumb_bob", D=D, K=K)
