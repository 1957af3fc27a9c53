# SPDX-License-Identifier: BSD-3-Clause
"""What a loss of power, or anybody else, has left of the files of a node."""

import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.playback.spool_records import are_numbers, are_poses, read_pose_lines, read_records

KIND = np.dtype([("stamp_ns", "<i8"), ("T", "<f8", (3, 4))])
LINE = b"1.000000000 0.1 -0.2 0.000000000 0.0 0.0 0.0 1.0\n"


def records(count):
    found = np.zeros(count, KIND)
    found["stamp_ns"] = 10**18 + np.arange(count)
    found["T"] = np.eye(4)[:3]
    return found


def sound(path, told):
    return np.concatenate(list(read_records(path, KIND, lambda found: are_poses(found["T"]), told.append)))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e9, 0.0, 2.0, -1.0])
def test_records_that_are_no_poses_are_left_out_and_counted(tmp_path, wrong):
    path, told = tmp_path / "frames.bin", []
    found = records(5)
    found["T"][3, 1, 1] = wrong
    path.write_bytes(found.tobytes() + b"part of one")
    assert sound(path, told)["stamp_ns"].tolist() == found["stamp_ns"][[0, 1, 2, 4]].tolist()
    assert told == [f"{path}: 1 of its 5 records are damaged and left out"]


def test_zeros_of_a_loss_of_power(tmp_path):
    path, told = tmp_path / "frames.bin", []
    path.write_bytes(records(5).tobytes() + bytes(3 * KIND.itemsize))
    assert len(sound(path, told)) == 5
    assert told == [f"{path}: 3 of its 8 records are damaged and left out"]


@pytest.mark.parametrize("stamp_ns", [-1, -(2**63), 2**63 - 1])
def test_stamps_that_are_none(tmp_path, stamp_ns):
    path, told = tmp_path / "frames.bin", []
    found = records(3)
    found["stamp_ns"][1] = stamp_ns
    path.write_bytes(found.tobytes())
    assert len(sound(path, told)) == 2


def test_a_file_of_nothing_else_is_an_error(tmp_path):
    path = tmp_path / "frames.bin"
    path.write_bytes(b"\xff" * 10 * KIND.itemsize)
    with pytest.raises(InputError, match="is damaged: none of its 10 records can be used"):
        sound(path, [])


def test_numbers_beyond_all_bounds():
    found = np.zeros(4, [("pose", "<f8", 3), ("covariance", "<f8", (3, 3))])
    found["pose"][1, 2], found["covariance"][2, 0, 0], found["covariance"][3, 0, 0] = np.nan, 1e12, 1e200
    assert are_numbers(found, "pose", "covariance").tolist() == [True, False, True, False]


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        bytes(50) + b"\n",
        b"nan" + LINE[1:],
        LINE.replace(b"0.1", b"inf"),
        LINE[:20] + b"\n",
        b"\xff\xfe\n",
        b"1" * 400 + LINE,
    ],
)
def test_lines_that_are_no_poses_are_left_out_and_counted(tmp_path, damage):
    path, told = tmp_path / "fused.tum", []
    path.write_bytes(3 * LINE + damage + 2 * LINE)
    assert b"".join(read_pose_lines(path, told.append)) == 5 * LINE
    assert told == [f"{path}: 1 of its 6 lines are damaged and left out"] * bool(damage)


def test_megabytes_without_a_line_end(tmp_path):
    path, told = tmp_path / "fused.tum", []
    path.write_bytes(LINE + bytes(5 * 10**6) + b"\n" + LINE)
    assert b"".join(read_pose_lines(path, told.append)) == 2 * LINE
    assert len(told) == 1
