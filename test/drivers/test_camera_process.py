# SPDX-License-Identifier: BSD-3-Clause
"""The process that streams, with cameras that do whatever cameras do; images are stamped as the node does."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fake_bench import exposure_ms_of, truth_of

from ceiling_dso_ros.drivers.camera_process import CameraProcess
from ceiling_dso_ros.drivers.image_times import COUNTER_US, StampSource
from ceiling_dso_ros.drivers.inertial import InertialPairs
from ceiling_dso_ros.drivers.reports import CapturedImages, Connected, InertialReadings, Waiting
from ceiling_dso_ros.drivers.settings import CameraSettings, ExposureSettings, Mode
from ceiling_dso_ros.drivers.stamping import ImageStamper

PATIENCE_S = 60.0
SMALL = Mode(424, 240, 30)


class Listener:
    """Hears a camera process, and stamps what it delivers.

    Attributes:
        images: (monotonic time, StampedImages) of all images that have a stamp.
        connections: descriptions, one for each connection.
        waiting: (monotonic time, message) of all that was said while there were no images.
        readings: of the inertial unit.
    """

    def __init__(self):
        self.images, self.connections, self.waiting, self.readings = [], [], [], []
        self.stamper = ImageStamper()

    def hear(self, report):
        if isinstance(report, Connected):
            self.connections.append(report.camera)
            self.stamper.connected()
        elif isinstance(report, Waiting):
            self.waiting.append((time.monotonic(), report.message))
        elif isinstance(report, InertialReadings):
            self.readings += report.readings
        elif isinstance(report, CapturedImages):
            stamped = self.stamper.stamp(report)
            if stamped is not None:
                self.images.append((time.monotonic(), stamped))

    def wait_for_images(self, count):
        """Wait for more images, a number of them."""
        before = len(self.images)
        wait_until(lambda: len(self.images) >= before + count, lambda: f"no images: {self.waiting[-1:]}")

    def wait_for(self, text):
        """Wait until a text is said from now on; returns how long that took."""
        start_s = time.monotonic()
        wait_until(
            lambda: any(said_s >= start_s and text in message for said_s, message in self.waiting[-100:]),
            lambda: f"not said: {text}, but {Counter(message for _, message in self.waiting)}",
        )
        return time.monotonic() - start_s


def wait_until(condition, complaint=lambda: "it takes too long"):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, complaint()
        time.sleep(0.01)


@pytest.fixture
def listen(bench):
    """Starts a camera process and gives its listener and itself."""
    started = []

    def start(**settings):
        listener = Listener()
        process = CameraProcess(CameraSettings(**{"mode": SMALL, **settings}), listener.hear)
        process.start()
        started.append(process)
        return listener, process

    yield start
    for process in started:
        pid = process.pid
        process.close()
        assert process.pid is None
        assert not Path(f"/proc/{pid}").exists()


def errors_ms(images):
    return np.array([1e-6 * (stamped.stamp_ns - truth_of(stamped.images[0])[1]) for _, stamped in images])


def require_right(images):
    """In order, with the exposure time of each image itself."""
    numbers = [truth_of(stamped.images[0])[0] for _, stamped in images]
    assert numbers == sorted(set(numbers))
    assert [stamped.exposure_ms for _, stamped in images] == pytest.approx([exposure_ms_of(n) for n in numbers])
    stamps_ns = [stamped.stamp_ns for _, stamped in images]
    assert stamps_ns == sorted(set(stamps_ns))


@pytest.mark.long
def test_images_come_in_order_with_their_exposures_and_times(bench, listen):
    bench.plug_in(jitter_ms=5.0, drift_ppm=50.0, counter_us=COUNTER_US - 4_000_000)  # wraps around meanwhile
    listener, _ = listen()
    listener.wait_for_images(300)
    require_right(listener.images)
    assert np.abs(errors_ms(listener.images)).max() < 2.0
    assert np.abs(np.median(errors_ms(listener.images[-100:]))) < 0.5
    (camera,) = listener.connections
    assert (camera.serial_no, camera.usb, camera.mode, camera.has_metadata) == ("1111", "3.2", SMALL, True)
    assert camera.complaints == ()
    assert camera.left.K[0, 0] == pytest.approx(212.65)
    assert listener.stamper.source is StampSource.MIDDLE


def test_the_emitter_is_off_and_the_exposure_is_limited(bench, listen):
    bench.plug_in()
    listener, process = listen(exposure=ExposureSettings(limit_ms=6.0, gain_limit=100, metering=0.5))
    listener.wait_for_images(3)
    options = bench.options()
    assert (options["emitter_enabled"], options["global_time_enabled"], options["enable_auto_exposure"]) == (0, 0, 1)
    assert (options["auto_exposure_limit"], options["auto_gain_limit"]) == (6000, 100)
    assert (options["auto_exposure_limit_toggle"], options["auto_gain_limit_toggle"]) == (1, 1)
    assert options["region"] == [152, 272, 60, 180]
    process.expose(ExposureSettings(fixed_ms=3.0, fixed_gain=32, limit_ms=6.0, gain_limit=100))
    wait_until(lambda: bench.options()["enable_auto_exposure"] == 0)
    wait_until(lambda: (bench.options().get("exposure"), bench.options().get("gain")) == (3000, 32))
    assert len(listener.connections) == 1
    process.expose(ExposureSettings(limit_ms=4.0))  # another limit counts from the next start on
    wait_until(lambda: len(listener.connections) == 2)
    assert (bench.options()["auto_exposure_limit"], bench.options()["auto_gain_limit_toggle"]) == (4000, 0)


def test_both_cameras_and_the_inertial_unit(bench, listen):
    bench.plug_in()
    listener, _ = listen(stereo=True, imu=True)
    listener.wait_for_images(30)
    (camera,) = listener.connections
    assert camera.T_left_right[:3, 3].tolist() == [0.095, 0.0, 0.0]
    assert camera.T_left_imu[:3, 3].tolist() == [0.03, 0.007, 0.016]
    for _, stamped in listener.images:
        assert [truth_of(image)[2] for image in stamped.images] == [1, 2]
    pairs = InertialPairs()
    samples = [sample for reading in list(listener.readings) for sample in pairs.add(reading)]
    steps_us = np.diff([sample.counter_us for sample in samples])
    assert np.abs(steps_us - 5000).max() <= 1
    steps = np.diff([sample.force[0] for sample in samples])
    begins_anew = np.abs(steps) > 1.0  # from 100 to 0, with one value that is interpolated between these
    assert begins_anew.sum() <= 2
    assert steps[~begins_anew] == pytest.approx(0.005, abs=1e-6)


def test_without_a_camera_the_reason_is_said_again_and_again(listen):
    listener, process = listen()
    for _ in range(3):
        listener.wait_for("no RealSense camera is connected")
        time.sleep(0.5)
    assert process.starts == 1


def test_one_of_two_cameras_is_chosen_by_its_serial_number(bench, listen):
    bench.plug_in("1111")
    bench.plug_in("2222")
    undecided, _ = listen()
    undecided.wait_for("the cameras 1111 and 2222 are connected: choose one with serial_no")
    first, _ = listen(serial_no="1111")
    second, _ = listen(serial_no="2222")
    third, _ = listen(serial_no="3333")
    first.wait_for_images(3)
    second.wait_for_images(3)
    third.wait_for("camera 3333 is not connected, but 1111 and 2222")
    assert [each.connections[0].serial_no for each in (first, second)] == ["1111", "2222"]


@pytest.mark.long
def test_an_unplugged_camera_comes_back(bench, listen):
    bench.plug_in(starting_s=0.5)
    listener, process = listen()
    listener.wait_for_images(10)
    bench.unplug()
    assert listener.wait_for("no RealSense camera is connected") < 2.0
    time.sleep(10.0)
    count, back_s = len(listener.images), time.monotonic()
    bench.plug_in(starting_s=0.5, port="1-1", counter_us=17)
    listener.wait_for_images(10)
    assert listener.images[count][0] - back_s < 3.0
    assert [camera.port for camera in listener.connections] == ["2-1", "1-1"]
    assert process.starts == 1
    require_stamps_grow(listener.images)


def require_stamps_grow(images):
    stamps_ns = [stamped.stamp_ns for _, stamped in images]
    assert stamps_ns == sorted(set(stamps_ns))


def test_a_camera_that_is_gone_for_a_moment_only(bench, listen):
    bench.plug_in()
    listener, _ = listen()
    listener.wait_for_images(10)
    bench.unplug()
    bench.plug_in(counter_us=123)
    listener.wait_for_images(60)
    require_stamps_grow(listener.images)


@pytest.mark.long
def test_a_silent_camera_is_started_anew(bench, listen):
    bench.plug_in()
    listener, _ = listen()
    listener.wait_for_images(3)
    bench.change(trouble="silent")
    assert listener.wait_for("camera 1111 gives no image for 1 s") < 2.0
    listener.wait_for("it is started anew")
    bench.change(trouble="")
    listener.wait_for_images(3)
    assert len(listener.connections) >= 2


@pytest.mark.long
@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("hang", "the streaming process has said nothing for 2.5 s"),
        ("crash", "the streaming process has ended with code -6"),
    ],
)
def test_a_library_that_hangs_or_crashes_is_started_again(bench, listen, trouble, said):
    bench.plug_in()
    listener, process = listen()
    listener.wait_for_images(3)
    bench.change(trouble=trouble)
    listener.wait_for(said)
    bench.change(trouble="")
    listener.wait_for_images(3)
    assert process.starts >= 2
    require_stamps_grow(listener.images)


def test_a_camera_that_refuses_to_start(bench, listen):
    bench.plug_in(trouble="refuse")
    listener, process = listen()
    listener.wait_for("the camera cannot be started: Couldn't resolve requests")
    bench.change(trouble="")
    listener.wait_for_images(3)
    assert process.starts == 1


@pytest.mark.parametrize("moment_s", [0.0, 0.1, 0.3, 1.0])
def test_the_process_may_be_killed_at_any_time(bench, listen, moment_s):
    bench.plug_in(starting_s=0.2)
    listener, process = listen()
    for _ in range(2):
        wait_until(lambda: process.pid is not None)
        time.sleep(moment_s)
        killed = process.pid
        os.kill(killed, signal.SIGKILL)
        wait_until(lambda killed=killed: process.pid not in (None, killed))
    listener.wait_for_images(10)
    require_stamps_grow(listener.images)


def test_by_usb_2_there_are_no_right_images(bench, listen):
    bench.plug_in(usb="2.1", modes=[[640, 480, 15], [424, 240, 30]])
    listener, _ = listen(stereo=True, mode=Mode(848, 480, 30))
    listener.wait_for_images(3)
    (camera,) = listener.connections
    assert camera.mode == Mode(424, 240, 30)
    assert camera.right is None
    assert camera.complaints == (
        "424x240 at 30 Hz instead of 848x480 at 30 Hz, which the camera does not offer",
        "there are no right images",
        "connected by USB 2.1: use a port and a cable of USB 3",
    )


def test_without_metadata_the_arrival_counts(bench, listen):
    bench.plug_in(metadata=False, delay_ms=1.0)
    listener, _ = listen()
    listener.wait_for_images(30)
    (camera,) = listener.connections
    assert camera.complaints == ("no metadata: this computer's kernel does not pass on exposure times",)
    assert {stamped.exposure_ms for _, stamped in listener.images} == {None}
    assert listener.stamper.source is StampSource.ARRIVAL
    late_ms = errors_ms(listener.images)
    assert (late_ms > 0.0).all()  # half an exposure and the way to here
    assert late_ms.max() < 60.0


def test_a_counter_that_was_set_is_followed(bench, listen):
    bench.plug_in()
    listener, _ = listen()
    listener.wait_for_images(10)
    bench.change(step_us=-2_000_000)
    listener.wait_for_images(60)
    require_right(listener.images)
    assert np.abs(errors_ms(listener.images[-20:])).max() < 5.0


def test_a_camera_is_reset_when_asked(bench, listen):
    bench.plug_in()
    listener, process = listen()
    listener.wait_for_images(3)
    assert process.reset_device()
    listener.wait_for("camera 1111 is reset")
    wait_until((bench.folder / "reset").exists)
    bench.unplug()
    bench.plug_in()
    listener.wait_for_images(3)
    assert process.starts == 1


@pytest.mark.parametrize("trouble", ["", "hang"])
def test_the_streaming_process_ends_with_the_one_that_started_it(bench, trouble):
    bench.plug_in()
    script = (
        "import sys, time\n"
        "from ceiling_dso_ros.drivers.camera_process import CameraProcess\n"
        "from ceiling_dso_ros.drivers.settings import CameraSettings\n"
        "def tell(report): print(process.pid, type(report).__name__, flush=True)\n"
        "process = CameraProcess(CameraSettings(), tell)\n"
        "process.start()\n"
        "time.sleep(600)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        line = next(line for line in parent.stdout if "CapturedImages" in line)
        threading.Thread(target=parent.stdout.read, daemon=True).start()
        bench.change(trouble=trouble)
        time.sleep(0.2)
    finally:
        parent.kill()
        parent.wait()
    child = Path(f"/proc/{line.split()[0]}")
    wait_until(lambda: not child.exists() or "Z" in (child / "stat").read_text().rpartition(")")[2].split()[:1])
