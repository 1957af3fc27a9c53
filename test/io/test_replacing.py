# SPDX-License-Identifier: BSD-3-Clause
import os
import re
from pathlib import Path

import pytest

from ceiling_dso_ros.io.errors import OutputError, reason_of
from ceiling_dso_ros.io.replacing import replace_file, replacing


def full(*_):
    raise OSError(28, "No space left on device")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_replaced_when_it_is_complete(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"old")
    with replacing(path, "it") as file:
        file.write(b"ne")
        assert path.read_bytes() == b"old"
        file.write(b"w")
    assert path.read_bytes() == b"new"
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("broken", [(Path, "replace"), (os, "fsync")])
def test_a_full_disk_leaves_what_was_there_and_nothing_else(tmp_path, monkeypatch, broken):
    path = tmp_path / "a"
    path.write_bytes(b"old")
    monkeypatch.setattr(*broken, full)
    with pytest.raises(OutputError, match=re.escape(f"{path}: cannot write it: No space left on device")):
        replace_file(path, b"new", "it")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a"]


def test_an_error_of_who_writes_leaves_nothing_either(tmp_path):
    with pytest.raises(KeyError), replacing(tmp_path / "a", "it") as file:
        file.write(b"half")
        raise KeyError
    assert names(tmp_path) == []


def test_a_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Not a directory"):
        replace_file(tmp_path / "file" / "a", b"new", "it")


def test_a_folder_in_the_way_stays(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError, match="Is a directory"):
        replace_file(tmp_path / "a", b"new", "it")
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError("of somebody else"), "of somebody else"),
        (OSError(), "OSError"),
    ],
)
def test_a_reason_is_never_none(error, reason):
    assert reason_of(error) == reason
