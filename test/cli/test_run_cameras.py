# SPDX-License-Identifier: BSD-3-Clause
"""Recordings as the drivers of real cameras make them: `run` tracks them as it tracks plain ones, or says why not."""

import json

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.ros_messages import message
from ceiling_dso_ros.io.trajectory import read_tum

pytestmark = pytest.mark.long(minutes=2)

WIDTH, HEIGHT, COUNT = 192, 144, 40
K = np.array([[120.0, 0, 95.5], [0, 120.0, 71.5], [0, 0, 1]])
BARREL = [-0.25, 0.06, 0.0, 0.0, 0.0]
IMAGE, INFO = "/camera/up/image_raw", "/camera/up/camera_info"


@pytest.fixture(scope="module")
def listed(tum_folder_of_module):
    """(stamp_ns, exposure_ms, image) of the small recording."""
    recording = open_recording(tum_folder_of_module)
    return [(image.stamp_ns, image.exposure_ms, image.decode()) for image in recording.images()]


@pytest.fixture
def bag(listed, tmp_path):
    """Write the recording as a bag, with other images and another camera_info."""

    def write(change=lambda image: image, encoding=None, topic=IMAGE, without_exposure=(), wrong=False, **info):
        path = tmp_path / "tour.bag"
        with BagWriter(path) as writer:
            for number, (stamp_ns, exposure_ms, image) in enumerate(listed):
                writer.write(INFO, stamp_ns, camera_info(stamp_ns, **info))
                if number not in without_exposure:
                    told_ms = (4.0, 4.4)[number % 2] if wrong else exposure_ms
                    writer.exposure("/camera/up/exposure", stamp_ns, "camera", told_ms)
                writer.image(topic, stamp_ns, "camera", change(image), encoding)
        return path

    return write


class Messages(BagWriter):
    """Keeps the last message instead of writing it."""

    def __init__(self):
        self._counts = {}

    def write(self, topic, stamp_ns, content, latched=False):
        self.last = content


def camera_info(stamp_ns, size=(WIDTH, HEIGHT), matrix=K, distortion=(0.0,) * 5, P=None, binning=0, roi=(0, 0, 0, 0)):
    messages = Messages()
    messages.camera_info(INFO, stamp_ns, "camera", size, matrix, distortion)
    info = messages.last
    names = ("x_offset", "y_offset", "width", "height")
    info.roi = message("sensor_msgs/RegionOfInterest", **dict(zip(names, roi)), do_rectify=False)
    info.binning_x = info.binning_y = binning
    info.P = info.P if P is None else np.hstack([P, np.zeros((3, 1))]).ravel()
    return info


def run(recording, out, *options):
    assert main(["run", str(recording), "--out", str(out), *options]) == 0
    return (out / "camera.tum").read_bytes(), json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module")
def plain(tum_folder_of_module, tmp_path_factory):
    """The trajectory of the recording as it is."""
    trajectory, summary = run(tum_folder_of_module, tmp_path_factory.mktemp("plain"))
    assert summary["tracked"] > COUNT / 2
    return trajectory


# The sensor is larger than the images: binned by two, with a region of interest that begins at (100, 60).
SENSOR = {
    "size": (600, 400),
    "matrix": np.array([[240.0, 0, 291.5], [0, 240.0, 203.5], [0, 0, 1]]),
    "binning": 2,
    "roi": (100, 60, 2 * WIDTH, 2 * HEIGHT),
}
DRIVERS = {
    "twelve bits": ({"change": lambda image: image.astype(np.uint16) << 4}, "4095 (12 bits)"),
    "yuv422": ({"change": lambda image: np.dstack([image // 2, image]), "encoding": "yuv422"}, ""),
    "binning and region of interest": (SENSOR, ""),
}


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_same_images_in_another_form_give_the_same_bytes(bag, plain, tmp_path, capsys, driver):
    arguments, warning = DRIVERS[driver]
    trajectory, summary = run(bag(**arguments), tmp_path / "out")
    assert trajectory == plain
    warnings = capsys.readouterr().err.splitlines()
    assert [f"warning: {line}" for line in summary["warnings"]] == warnings
    assert len(warnings) == bool(warning)
    assert all(warning in line for line in warnings)


def test_a_bit_depth_that_is_given_needs_no_warning(bag, plain, tmp_path, capsys):
    twelve = bag(lambda image: image.astype(np.uint16) << 4)
    trajectory, _ = run(twelve, tmp_path / "out", "--bits", "12")
    assert (trajectory, capsys.readouterr().err) == (plain, "")
    assert main(["run", str(twelve), "--out", str(tmp_path / "out"), "--bits", "17"]) == 2
    assert capsys.readouterr().err == "error: --bits 17: 8 to 16, or 0 to find it from the images\n"


def test_rectified_images(bag, plain, tmp_path, capsys):
    rectified = bag(topic="/camera/up/image_rect", distortion=BARREL, P=K, matrix=1.1 * K - np.diag([0, 0, 0.1]))
    topic = ("--image-topic", "/camera/up/image_rect")
    trajectory, _ = run(rectified, tmp_path / "out", *topic, "--rectified")
    assert (trajectory, capsys.readouterr().err) == (plain, "")
    trajectory, summary = run(rectified, tmp_path / "distorted", *topic)
    assert trajectory != plain
    assert summary["warnings"][0].startswith("/camera/up/image_rect: by its name these images are rectified")
    assert summary["warnings"][0] in capsys.readouterr().err


def test_the_mosaic_of_a_sensor_is_tracked(bag, plain, tmp_path):
    """Demosaicing blurs grey images a little."""
    _, summary = run(bag(encoding="bayer_rggb8"), tmp_path / "out")
    trajectory, expected = read_tum(tmp_path / "out" / "camera.tum"), tum(plain, tmp_path)
    assert summary["warnings"] == []
    assert summary["tracked"] >= len(expected) - 3
    way = trajectory.positions[-1] - trajectory.positions[0]
    direction = way / np.linalg.norm(way)
    expected_way = expected.positions[-1] - expected.positions[0]
    assert direction @ expected_way / np.linalg.norm(expected_way) > 0.999


def tum(content, folder):
    (folder / "plain.tum").write_bytes(content)
    return read_tum(folder / "plain.tum")


@pytest.mark.parametrize("form", ["bag", "folder"])
def test_images_of_a_size_that_cannot_be_tracked_are_cropped(bag, tum_folder, tmp_path, capsys, form):
    if form == "bag":
        recording = bag(lambda image: image[:143, :191], size=(191, 143))
    else:
        recording = tum_folder
        for path in (tum_folder / "images").iterdir():
            cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[:143, :191])
        camera = (tum_folder / "camera.txt").read_text()
        (tum_folder / "camera.txt").write_text(camera.replace("192 144", "191 143"))
    _, summary = run(recording, tmp_path / "out")
    assert summary["tracked"] > COUNT / 2
    (warning,) = capsys.readouterr().err.splitlines()
    assert "images of 191x143 pixels cannot be halved often enough" in warning
    assert "they are cropped to 188x140" in warning


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"encoding": "8SC1"}, f"{IMAGE}, message 1: image encoding '8SC1' cannot be read as grey"),
        ({"size": (640, 480)}, f"{IMAGE}, message 1: the image is 192x144, but the calibration is for 640x480"),
    ],
)
def test_a_recording_without_any_usable_image_is_refused_in_one_line(bag, tmp_path, capsys, arguments, complaint):
    assert main(["run", str(bag(**arguments)), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: none of the {COUNT} images can be used; the first: {tmp_path}/tour.bag, ")
    assert complaint in line
    assert not list((tmp_path / "out").glob("*.tum"))


def test_images_too_small_to_be_tracked_are_refused_in_one_line(bag, tmp_path, capsys):
    small = bag(lambda image: image[:100, :120], size=(120, 100), matrix=K - [[0, 0, 36], [0, 0, 22], [0, 0, 0]])
    for command in (["run", str(small), "--out", str(tmp_path / "out")], ["benchmark", str(small)]):
        assert main(command) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "images of 120x100 pixels: too small to be tracked" in line


def test_it_says_why_nothing_was_tracked(bag, tmp_path, capsys):
    assert main(["run", str(bag(np.zeros_like)), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"tour.bag: 0 of {COUNT} images have a pose; the most frequent reason (" in line
    assert line.rpartition(": ")[2].strip()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["end"].startswith("failed: ")
    assert summary["tracked"] == 0


def test_warnings_of_one_kind_are_counted(bag, tmp_path, capsys):
    count = iter(range(COUNT))
    recording = bag(lambda image: image[:100] if next(count) % 4 == 3 else image)
    _, summary = run(recording, tmp_path / "out")
    first = f"{recording}, {IMAGE}, message 4: the image is 192x100, but the calibration is for 192x144; frame skipped"
    warnings = capsys.readouterr().err.splitlines()
    assert warnings[:2] == [f"warning: {first}", f"warning: ... and 9 more, the first was: {first}"]
    assert summary["warnings"][0] == f"{first} ... and 9 more"
    assert (summary["frames"], summary["skipped"]) == (30, 10)


def test_a_missing_exposure_is_unknown(bag):
    recording = open_recording(bag(without_exposure=(7, 30)))
    unknown = [number for number, frame in enumerate(recording.frames()) if frame.exposure_ms is None]
    assert unknown == [7, 30]


def test_exposures_can_be_left_out(bag, tmp_path):
    """As if the recording had none, to the last bit; with them, which are wrong, the poses are others."""

    def tracked(name, path, *options):
        assert main(["run", str(path), "--out", str(tmp_path / name), *options]) == 0
        return (tmp_path / name / "camera.tum").read_text()

    left_out = tracked("left out", bag(wrong=True), "--no-exposure")
    assert left_out == tracked("none", bag(without_exposure=range(COUNT)))
    assert left_out != tracked("used", bag(wrong=True))
