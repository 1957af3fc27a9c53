# SPDX-License-Identifier: BSD-3-Clause
import os
import re
from pathlib import Path

import pytest

from ceiling_dso_ros.io.errors import InputError, OutputError, reason_of
from ceiling_dso_ros.io.replacing import replace_file, replacing, require_writable, write_each


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


def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "real").write_bytes(b"old")
    (tmp_path / "a").symlink_to("there/real")
    replace_file(tmp_path / "a", b"new", "it")
    assert (tmp_path / "a").is_symlink()
    assert (tmp_path / "there" / "real").read_bytes() == b"new"
    assert names(tmp_path / "there") == ["real"]


def test_a_device_is_written_to_and_never_replaced(tmp_path):
    (tmp_path / "a").symlink_to("/dev/null")
    (tmp_path / "b").symlink_to("/dev/full")
    replace_file(tmp_path / "a", b"new", "it")
    with pytest.raises(OutputError, match="No space left on device"):
        replace_file(tmp_path / "b", b"new", "it")
    assert (tmp_path / "a").is_char_device()
    assert (tmp_path / "b").is_char_device()


def test_each_file_is_tried_and_each_failure_is_a_line(tmp_path):
    def broken(_):
        raise ValueError("no such number")

    def unreadable(_):
        raise InputError("input.bin: is gone")

    def whole(path):
        replace_file(path, b"new", "it")

    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError) as failed:
        write_each(tmp_path, {"folder": whole, "a": broken, "b": unreadable, "c": whole})
    assert failed.value.lines == (
        f"{tmp_path / 'folder'}: cannot write it: Is a directory",
        f"{tmp_path / 'a'}: cannot compute what belongs there: ValueError: no such number",
        "input.bin: is gone",
    )
    assert str(failed.value) == "; ".join(failed.value.lines)
    assert names(tmp_path) == ["c", "folder"]


def test_trying_a_folder_makes_it_and_leaves_nothing(tmp_path):
    (tmp_path / "file").touch()
    require_writable(tmp_path / "new" / "folder", ["a"])
    assert names(tmp_path / "new" / "folder") == []
    for folder, reason in (("file", "File exists"), ("file/folder", "Not a directory")):
        with pytest.raises(OutputError, match=re.escape(f"{tmp_path / folder}: cannot write there: {reason}")):
            require_writable(tmp_path / folder)
    with pytest.raises(OutputError, match=re.escape(f"{tmp_path / 'new'}: cannot write the file: Is a directory")):
        require_writable(tmp_path, ["file", "new"])


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
