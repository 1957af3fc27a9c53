# SPDX-License-Identifier: BSD-3-Clause
"""What the library itself records and plays, from a software device: read by the commands, and by the driver."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyrealsense2")

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.simulation.bag import write_measurements
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.sensors.measurements import CameraFrame

pytestmark = pytest.mark.long

# Processes of their own: the library's threads and the stand-in of other tests stay out of this one.
RECORD = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from realsense_recorder import record
from ceiling_dso_ros.io.opening import open_recording
drive = open_recording(sys.argv[2])
moments = []
for image in drive.images():
    exposure_us = 1000 * image.exposure_ms
    moments.append((image.stamp_ns / 1000 + exposure_us / 2, exposure_us, image.decode()))
record(sys.argv[3], drive.calibration.lens, moments, 15)
"""


def run(script, *arguments):
    words = [sys.executable, "-c", script, str(Path(__file__).parent), *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    result = subprocess.run(words, capture_output=True, text=True, timeout=300, env=environment)
    assert result.returncode == 0, result.stderr
    return result.stdout


def as_a_camera_counts(measurement):
    """Stamps in whole microseconds, exposures in pairs of them, so that their middle is one, too."""
    if not isinstance(measurement, CameraFrame):
        return measurement
    return replace(
        measurement,
        stamp_ns=1000 * round(measurement.stamp_ns / 1000),
        exposure_ms=round(500 * measurement.exposure_ms) / 500,
    )


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """A rendered drive as a bag of this package, and as one of the library's recorder."""
    folder = tmp_path_factory.mktemp("drives")
    drive, recorded = folder / "drive.bag", folder / "recorded.bag"
    camera = CameraModel(width=424, height=240, fps=15.0)
    recording = SimulatedRecording(SimulationConfig("loops", "factory", camera=camera, duration_s=8.0))
    with BagWriter(drive) as bag:
        write_measurements(bag, recording, map(as_a_camera_counts, recording.simulation.measurements()))
    run(RECORD, drive, recorded)
    return drive, recorded


def test_every_image_has_its_stamp_and_exposure(bags):
    ours, theirs = ([*open_recording(path).images()] for path in bags)
    assert len(theirs) == len(ours)
    for expected, found in zip(ours, theirs):
        assert found.stamp_ns == expected.stamp_ns
        assert found.exposure_ms == expected.exposure_ms
        np.testing.assert_array_equal(found.decode(), expected.decode())


def test_the_calibration_is_that_of_the_camera(bags):
    ours, theirs = (open_recording(path).calibration for path in bags)
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(theirs.lens, name) == pytest.approx(getattr(ours.lens, name), rel=1e-6)
    assert theirs.lens.distortion == ()


def test_the_trajectory_is_that_of_the_drives_own_bag(bags, tmp_path):
    """To the last digit, with the same calibration; that of the recording is in single precision.

    Which has no wheels: nothing is predicted.
    """
    lens = open_recording(bags[0]).calibration.lens
    size = f"{lens.width} {lens.height}"
    camera = tmp_path / "camera.txt"
    camera.write_text(f"Pinhole {lens.fx!r} {lens.fy!r} {lens.cx!r} {lens.cy!r} 0\n{size}\nnone\n{size}\n")
    for bag in bags:
        options = ["--camera", str(camera), "--no-prediction", "--out", str(tmp_path / bag.stem)]
        assert main(["run", str(bag), *options]) == 0
    for name in ("camera.tum", "camera_final.tum", "keyframes.tum"):
        ours, theirs = ((tmp_path / bag.stem / name).read_text() for bag in bags)
        assert theirs == ours
        assert len(ours.splitlines()) > 20


def test_calibrate_says_in_one_line_that_there_are_no_wheels(bags, tmp_path, capsys):
    assert main(["calibrate", str(bags[1]), "--out", str(tmp_path / "robot.yaml")]) == 2
    assert capsys.readouterr().err.strip().endswith("has no wheels; record joint_states, ticks or encoders.csv")


PLAY = """
import sys
from ceiling_dso_ros.drivers.image_times import StampSource
from ceiling_dso_ros.drivers.realsense_stream import RealsenseStream
from ceiling_dso_ros.drivers.settings import CameraSettings
from ceiling_dso_ros.drivers.stamping import ImageStamper

stream = RealsenseStream(CameraSettings(recording=sys.argv[2]))
stamper = ImageStamper()
print(stream.camera.serial_no, stream.camera.mode.width, stream.camera.left.K[0, 0])
while (captured := stream.capture(1.0)) is not None:
    stamped = stamper.stamp(captured)
    if stamped is not None:
        print(captured.number, stamped.stamp_ns, stamped.exposure_ms, stamped.images[0].sum())
print(stamper.source is StampSource.MIDDLE)
stream.close()
"""


def test_the_driver_plays_a_recording(bags):
    """In real time, with the exposures of the images themselves."""
    drive = {int(image.decode().sum()): image for image in open_recording(bags[0]).images()}
    first, *lines, is_middle = run(PLAY, bags[1]).splitlines()
    assert first.split()[:2] == ["0123456789", "424"]
    assert is_middle == "True"
    assert len(lines) > 50
    stamps_s = []
    for line in lines:
        _, stamp_ns, exposure_ms, checksum = line.split()
        image = drive[int(checksum)]
        assert float(exposure_ms) == pytest.approx(image.exposure_ms, abs=6e-4)
        stamps_s.append((1e-9 * int(stamp_ns), 1e-9 * (image.stamp_ns - next(iter(drive.values())).stamp_ns)))
    live_s, drive_s = np.array(stamps_s).T
    assert np.ptp(live_s - drive_s) < 0.02


LIBRARY = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
import pyrealsense2 as rs
from realsense_recorder import SoftwareCamera
from ceiling_dso_ros.drivers import realsense_device, realsense_stream
from ceiling_dso_ros.drivers.image_times import StampSource, before_readout
from ceiling_dso_ros.drivers.settings import Mode
from ceiling_dso_ros.io.lens_models import LensCamera

lens = LensCamera("Pinhole", 212.6, 212.7, 211.0, 119.0, (), 424, 240)
camera = SoftwareCamera(lens, 30, (1, 2))
camera.profiles[1].register_extrinsics_to(camera.profiles[0], extrinsics := rs.extrinsics())
(sensor,) = camera.device.query_sensors()
assert realsense_device.infrared_modes(realsense_device.infrared_sensor(camera.device)) == {
    1: {Mode(424, 240, 30)}, 2: {Mode(424, 240, 30)}
}
assert realsense_device.motion_profiles(camera.device) == (None, [])
assert abs(realsense_device.lens_of(camera.profiles[0]).K - lens.matrix).max() < 1e-4
queue = rs.frame_queue(10, keep_frames=True)
camera.sensor.open(camera.profiles)
camera.sensor.start(queue)
image = np.arange(424 * 240, dtype=np.uint8).reshape(240, 424)
camera.send(7, 5_000_000.0, 8000.0, [image, image])
frame = queue.wait_for_frame(2000)
known = realsense_stream.metadata_of(frame)
assert known == {
    "frame_counter": 7, "frame_timestamp": 5_000_000, "sensor_timestamp": 4_996_000, "actual_exposure": 8000,
    "gain_level": 16,
}
times = realsense_stream.frame_times(frame, known)
assert (times.counter_us, times.exposure_ms, times.of_device) == (5_000_000, 8.0, True)
assert before_readout(times) == (4000, StampSource.MIDDLE)
# With the library's own time, the counter is there all the same.
camera.send(8, 5_033_000.0, 8000.0, [image, image], rs.timestamp_domain.global_time)
queue.wait_for_frame(2000)
frame = queue.wait_for_frame(2000)
assert realsense_stream.frame_times(frame, realsense_stream.metadata_of(frame))[:2] == (5033.0, True)
assert (np.array(frame.get_data()) == image).all()
print("right")
"""


def test_what_the_library_says_of_frames_and_streams():
    assert run(LIBRARY) == "right\n"
