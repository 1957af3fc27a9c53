# SPDX-License-Identifier: BSD-3-Clause
"""Whole files or none, each with its reason, whatever becomes of the others."""

import os
import sys

import pytest

from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.rolling_file import old_part
from ceiling_dso_ros.playback.fusion_spool import FusionSpool
from ceiling_dso_ros.playback.spool import SpoolFolder
from ceiling_dso_ros.playback.spool_files import is_spool, set_aside, write_all, write_all_apart, write_copies

LINE = b"1.000000000 0.0 0.0 0.0 0.0 0.0 0.0 1.0\n"


@pytest.fixture
def kept(tmp_path):
    """A spool of fusion_node with two poses of the wheels."""
    spool = FusionSpool(SpoolFolder(tmp_path, "fusion_node"), 10**6, FusionConfig())
    (spool.path / "wheel.tum").write_bytes(2 * LINE)
    return spool.path


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_one_file_that_cannot_be_written_does_not_stop_the_others(kept, out):
    (out / "fused.tum").mkdir()
    written = write_all(kept, out)
    assert written.poses == {"wheel.tum": 2, "fused_smoothed.tum": 0}
    assert written.errors == [f"{out / 'fused.tum'}: cannot write the trajectory: Is a directory"]
    assert names(out) == ["fused.tum", "fused_smoothed.tum", "wheel.tum"]
    assert str(written) == "wheel.tum (2 poses), fused_smoothed.tum (0 poses)"


def test_a_full_disk_leaves_no_parts(kept, out, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    written = write_all(kept, out)
    assert written.poses == {}
    assert written.errors == [
        f"{out / name}: cannot write the trajectory: No space left on device"
        for name in ("wheel.tum", "fused.tum", "fused_smoothed.tum")
    ]
    assert names(out) == []


def test_a_copy_has_the_older_part_first(kept, out):
    old_part(kept / "wheel.tum").write_bytes(3 * LINE.replace(b"1.0", b"0.5", 1))
    assert write_copies(kept, out).poses["wheel.tum"] == 5
    assert (out / "wheel.tum").read_bytes() == 3 * LINE.replace(b"1.0", b"0.5", 1) + 2 * LINE


def test_nonsense_in_a_spool_is_an_error_of_one_file(kept, out):
    (kept / "motions.bin").write_bytes(b"\xff" * 10_000)
    written = write_all(kept, out)
    assert list(written.poses) == ["wheel.tum", "fused.tum"]
    (error,) = written.errors
    assert error.startswith(f"{kept / 'motions.bin'}: is damaged: none of its ")
    assert names(out) == ["fused.tum", "wheel.tum"]


def test_another_process_writes_the_same(kept, out, tmp_path):
    (tmp_path / "here").mkdir()
    assert write_all_apart(kept, out) == write_all(kept, tmp_path / "here")
    assert names(out) == ["fused.tum", "fused_smoothed.tum", "wheel.tum"]
    for name in names(out):
        assert (out / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_a_process_that_fails_is_an_error_and_what_can_be_copied_is_there(kept, out, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    written = write_all_apart(kept, out)
    assert written.errors == [f"{kept}: no trajectories could be computed: exit code 1"]
    assert list(written.poses) == names(out)[::-1] == ["wheel.tum", "fused.tum"]
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert "No such file" in write_all_apart(kept, out).errors[0]


def test_what_is_a_spool(kept, tmp_path):
    assert is_spool(kept)
    assert not is_spool(tmp_path)
    assert not is_spool(kept / "wheel.tum")


def test_what_another_run_has_written_is_not_replaced(kept, out):
    """A node that was started again ends with the same folder."""
    (kept / "fused.tum").write_bytes(2 * LINE)
    assert set_aside(kept, out) is None
    write_all(kept, out)
    assert set_aside(kept, out) is None  # it is of this run
    for number in (1, 2):
        (kept / "fused.tum").write_bytes(LINE.replace(b"1.000000000", b"%d.000000000" % (number + 1)))
        (out / "camera.tum").write_bytes(LINE)  # of another node
        assert set_aside(kept, out) == out / f"before.{number}"
        assert names(out / f"before.{number}") == ["fused.tum", "fused_smoothed.tum", "wheel.tum"]
        write_all(kept, out)
    assert (out / "before.1" / "fused.tum").read_bytes() == 2 * LINE
    assert names(out) == ["before.1", "before.2", "camera.tum", "fused.tum", "fused_smoothed.tum", "wheel.tum"]
