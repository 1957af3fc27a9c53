# SPDX-License-Identifier: BSD-3-Clause
"""Text files as editors and spreadsheets of any system write them."""

import re
import tracemalloc
from pathlib import Path

import pytest

from ceiling_dso_ros.io import text_files
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.text_files import read_lines, read_table, read_text
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.settings import load_settings

FILES = ("times.txt", "camera.txt", "encoders.csv", "robot.yaml", "groundtruth.tum", "pcalib.txt", "settings.yaml")


@pytest.fixture
def folder(tum_folder):
    """A recording with every kind of text file."""
    (tum_folder / "pcalib.txt").write_text(" ".join(str(value**2) for value in range(256)))
    (tum_folder / "settings.yaml").write_text("window: {max_keyframes: 5}\n")
    return tum_folder


def contents(folder):
    """All that is read from the folder's text files."""
    recording = open_recording(folder)
    frames = [(frame.stamp_ns, frame.exposure_ms) for frame in recording.frames()]
    settings = load_settings(folder / "settings.yaml")
    reference = read_tum(folder / "groundtruth.tum")
    robot = recording.robot
    return (
        *(frames, recording.calibration, recording.photometric.inverse_response.tolist(), settings),
        *(recording.wheels.stamps_ns.tolist(), recording.wheels.readings.tolist(), reference.stamps_ns.tolist()),
        *(robot.wheel_base_m, robot.T_base_camera.tolist()),
    )


@pytest.mark.parametrize("name", FILES)
def test_a_byte_order_mark_and_line_ends_of_windows_change_nothing(folder, name):
    before = contents(folder)
    path = folder / name
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert contents(folder) == before


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_another_encoding_is_one_line_that_names_the_file(folder, name, encoding):
    path = folder / name
    path.write_bytes(("# Gr\u00f6\u00dfe\n" + path.read_text()).encode(encoding))
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: is not a text file in UTF-8: byte 0x.. in line 1$"):
        contents(folder)


def test_lines_are_numbered_as_an_editor_does(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbf# head\r\n\r\n one \r\ntwo")
    assert read_lines(path) == [(f"{path}, line 3", "one"), (f"{path}, line 4", "two")]
    assert list(read_table(path)) == [(3, "one"), (4, "two")]


def test_line_ends_of_old_systems(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"one\r# head\rtwo\r")
    assert list(read_table(path)) == [(1, "one"), (3, "two")]


def test_a_long_trajectory_takes_memory_for_its_numbers_only(tmp_path):
    """A million lines are read in some seconds and 250 MB."""
    path = tmp_path / "long.tum"
    lines = 5_000
    path.write_text("".join(f"{k}.5 0.123456789 0 0 0 0 0 1\n" for k in range(lines)))
    tracemalloc.start()
    trajectory = read_tum(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(trajectory) == lines
    assert peak < 450 * lines


def test_a_table_without_lines_is_not_read_to_its_end(tmp_path):
    path = tmp_path / "a.tum"
    with path.open("wb") as file:
        file.truncate(2**31)
    with pytest.raises(InputError, match=re.escape(f"{path}, line 1: has more than 10000 characters")):
        list(read_table(path))
    with pytest.raises(InputError, match=re.escape(f"{path}: has more than 100000 bytes")):
        read_text(path)


def test_a_table_that_never_ends():
    path = Path("/dev/zero")
    for read in (read_text, lambda path: list(read_table(path))):
        with pytest.raises(InputError, match=r"^/dev/zero"):
            read(path)


def test_a_table_that_is_too_large(tmp_path, monkeypatch):
    path = tmp_path / "a.tum"
    path.write_text("1 0 0 0 0 0 0 1\n" * 10)
    monkeypatch.setattr(text_files, "MOST_TABLE_BYTES", 100)
    with pytest.raises(InputError, match=re.escape(f"{path}: has more than 100 bytes; split it")):
        read_tum(path)


def in_nanoseconds(text, column, separator):
    """The text with the stamps of a column as whole nanoseconds."""
    lines = []
    for line in text.splitlines():
        words = line.split(separator)
        if words[column][0].isdigit():
            seconds, _, decimals = words[column].partition(".")
            words[column] = str(int(seconds + f"{decimals:0<9}"))
        lines.append(separator.join(words))
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("name", "column", "separator"), [("times.txt", 1, " "), ("encoders.csv", 0, ","), ("groundtruth.tum", 0, " ")]
)
def test_stamps_in_nanoseconds_are_recognised(folder, name, column, separator):
    before = contents(folder)
    path = folder / name
    path.write_text(in_nanoseconds(path.read_text(), column, separator))
    assert max(map(len, re.split("[ ,\n]", path.read_text()))) == 19
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("times.txt", "0 1700000001000\n1 1700000001033\n"),
        ("encoders.csv", "1700000001000,1,2\n1700000001020,2,3\n"),
        ("groundtruth.tum", "1700000001000 0 0 0 0 0 0 1\n1700000001010 0 0 0 0 0 0 1\n"),
    ],
)
def test_milliseconds_are_refused(folder, name, text):
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=f"{name}: stamps that are .. apart are neither seconds nor nanoseconds"):
        contents(folder)
