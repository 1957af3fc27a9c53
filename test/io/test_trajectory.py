# SPDX-License-Identifier: BSD-3-Clause
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.errors import InputError, OutputError
from ceiling_dso_ros.io.trajectory import Trajectory, read_tum, tum_lines, write_tum


def a_trajectory(count=20):
    rng = np.random.default_rng(3)
    stamps_ns = 1_732_800_000_123_456_789 + 33_333_333 * np.arange(count)
    return Trajectory(stamps_ns, rng.normal(size=(count, 3)), Rotation.random(count, random_state=3).as_quat())


def test_what_is_written_comes_back(tmp_path):
    trajectory = a_trajectory()
    write_tum(tmp_path / "a.tum", trajectory)
    back = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(back.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_allclose(back.positions, trajectory.positions, atol=1e-9)
    np.testing.assert_allclose(back.quaternions_xyzw, trajectory.quaternions_xyzw, atol=2e-9)
    np.testing.assert_allclose(np.linalg.norm(back.quaternions_xyzw, axis=1), 1.0, atol=1e-15)


def test_stamps_survive_byte_for_byte(tmp_path):
    path = tmp_path / "a.tum"
    stamps = ["0.000000001", "1732800000.123456789", "1732800000.123456790"]
    path.write_text("".join(f"{stamp} {' '.join(['0.000000000'] * 6)} 1.000000000\n" for stamp in stamps))
    write_tum(tmp_path / "b.tum", read_tum(path))
    assert (tmp_path / "b.tum").read_bytes() == path.read_bytes()


def test_times_count_from_the_first_pose():
    begin_ns = 1_732_800_000_123_456_789
    trajectory = Trajectory.from_matrices([begin_ns, begin_ns + 500_000_000], [np.eye(4)] * 2)
    assert trajectory.times_s.tolist() == [0.0, 0.5]
    assert Trajectory.from_matrices([], []).times_s.tolist() == []


def test_matrices_and_back():
    trajectory = a_trajectory()
    T = trajectory.matrices()
    back = Trajectory.from_matrices(trajectory.stamps_ns, T)
    np.testing.assert_allclose(back.matrices(), T, atol=1e-14)
    assert Trajectory.from_matrices([], []).matrices().shape == (0, 4, 4)


def test_lines_of_parts_are_those_of_the_whole(tmp_path):
    """So a file may grow with the run."""
    whole = a_trajectory()
    parts = [
        Trajectory(whole.stamps_ns[part], whole.positions[part], whole.quaternions_xyzw[part])
        for part in (slice(0, 7), slice(7, 7), slice(7, None))
    ]
    write_tum(tmp_path / "whole.tum", whole)
    assert b"".join(map(tum_lines, parts)) == (tmp_path / "whole.tum").read_bytes()


def test_comments_blank_lines_and_long_quaternions(tmp_path):
    path = tmp_path / "a.tum"
    path.write_text("# stamp tx ty tz qx qy qz qw\n\n1.5 1 2 3 0 0 0 2\n  # more\n2.5,1,2,3,0,0,3,4\n")
    trajectory = read_tum(path)
    np.testing.assert_array_equal(trajectory.stamps_ns, [1_500_000_000, 2_500_000_000])
    np.testing.assert_allclose(trajectory.quaternions_xyzw, [[0, 0, 0, 1], [0, 0, 0.6, 0.8]])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1 1 2 3 0 0 0 1\n2 1 2 3 0 0 0\n", "line 2: 7 numbers instead of 8: stamp tx ty tz qx qy qz qw"),
        ("1 1 2 x 0 0 0 1\n", "line 1: could not convert string to float: 'x'; expected 'stamp tx ty tz qx qy qz qw'"),
        ("1 1 2 nan 0 0 0 1\n", "line 1: a number is not finite"),
        ("nan 1 2 3 0 0 0 1\n", "line 1: 'nan' is not a time in seconds; expected"),
        ("1 1 2 3 0 0 0 0\n", "line 1: the quaternion is zero"),
        ("#\n2 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "line 3: the stamp is not later than the one before; sort the file"),
        ("2 1 2 3 0 0 0 1\n2 1 2 3 0 0 0 1\n", "line 2: the stamp is that of the line before; remove one of the two"),
    ],
)
def test_bad_lines_are_named(tmp_path, text, complaint):
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(f"{path}, {complaint}")):
        read_tum(path)


def test_bad_lines_are_left_out_where_somebody_is_told(tmp_path):
    path = tmp_path / "a.tum"
    good = [f"{stamp} {stamp} 2 3 0 0 0 1" for stamp in range(1, 6)]
    path.write_text(
        "\n".join(["t x y z", good[0], "2 x 2 3 0 0 0 1", good[1], good[1], "2.5 y 2 3 0 0 0 1", *good[2:]])
    )
    told = []
    assert read_tum(path, told.append).positions[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert [text[len(f"{path}, ") :] for text in told] == [
        "line 1: 't' is not a time in seconds; expected 'stamp tx ty tz qx qy qz qw'; left out",
        "line 3: could not convert string to float: 'x'; expected 'stamp tx ty tz qx qy qz qw'; left out, "
        "as are 1 more such lines",
        "line 5: the stamp is that of another line; left out",
    ]
    path.write_text("t x y z\n")
    with pytest.raises(InputError, match="line 1: 't' is not a time in seconds"):
        read_tum(path, told.append)


def test_files_that_hold_no_trajectory(tmp_path):
    (tmp_path / "empty.tum").write_text("# nothing\n")
    (tmp_path / "binary.tum").write_bytes(b"\xff\xfe\x00")
    for name, complaint in [
        ("missing.tum", "cannot read the file: No such file or directory"),
        ("binary.tum", "is not a text file"),
        ("empty.tum", "no poses in it"),
    ]:
        for tell in (None, [].append):
            with pytest.raises(InputError, match=re.escape(f"{tmp_path / name}: {complaint}")):
                read_tum(tmp_path / name, tell)


def test_an_older_file_survives_a_failed_write(tmp_path, monkeypatch):
    path = tmp_path / "a.tum"
    path.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OutputError, match=re.escape(f"{path}: cannot write the trajectory: No space left on device")):
        write_tum(path, a_trajectory())
    assert path.read_text() == "old"


def test_a_folder_that_is_not_there(tmp_path):
    path = tmp_path / "missing" / "a.tum"
    with pytest.raises(OutputError, match=re.escape(f"{path}: cannot write the trajectory: No such file")):
        write_tum(path, a_trajectory())
