# SPDX-License-Identifier: BSD-3-Clause
import re

import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.rolling_file import RollingFile, old_part, read_rolling


class FullDisk:
    """A file of which only some bytes reach the disk before it is full."""

    def __init__(self, file, room):
        self._file, self._room = file, room

    def write(self, data):
        if self._room == 0:
            raise OSError(28, "No space left on device")
        taken = min(len(data), self._room)
        self._room -= taken
        return self._file.write(data[:taken])

    def fileno(self):
        return self._file.fileno()

    def close(self):
        self._file.close()


def read(path, record_size=0):
    return b"".join(read_rolling(path, record_size))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "records"


def test_what_is_appended_is_on_the_disk_after_a_flush(path):
    file = RollingFile(path, 1000)
    file.append(b"one\n")
    assert read(path) == b""
    file.append(b"two\n")
    file.flush()
    file.append(b"three\n")
    assert read(path) == b"one\ntwo\n"


def test_it_never_grows_beyond_its_limit_and_keeps_at_least_half_of_that(path):
    file = RollingFile(path, 200)
    for number in range(100):
        file.append(b"%08d\n" % number)
        file.flush()
        size = sum(part.stat().st_size for part in (path, old_part(path)) if part.exists())
        assert size <= 200
    kept = [int(line) for line in read(path).split()]
    assert kept == [*range(100 - len(kept), 100)]
    assert 9 * len(kept) >= 100


def test_it_begins_anew_without_what_came_before(path):
    file = RollingFile(path, 40)
    for _ in range(5):
        file.append(b"0123456789\n")
        file.flush()
    assert old_part(path).exists()
    file.append(b"never written\n")
    file.clear()
    file.append(b"new\n")
    file.flush()
    assert read(path) == b"new\n"


def test_a_full_disk_leaves_whole_records_and_what_comes_later_is_written_again(path):
    file = RollingFile(path, 1000)
    file.append(b"before\n")
    file.flush()
    whole = file._file
    file._file = FullDisk(whole, room=3)
    file.append(b"lost\n")
    with pytest.raises(OSError, match="No space left"):
        file.flush()
    assert path.read_bytes() == b"before\n"
    file._file = whole
    file.append(b"after\n")
    file.flush()
    assert read(path) == b"before\nafter\n"


def test_a_disk_that_does_not_answer_does_not_fill_the_memory(path, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.io.rolling_file.MOST_PENDING", 100)
    file = RollingFile(path, 1000)
    for number in range(50):
        file.append(b"%08d\n" % number)
    given_up = file.lost
    file.flush()
    assert len(read(path)) <= 100
    assert read(path).endswith(b"00000049\n")
    assert given_up == file.lost == 50 - len(read(path).splitlines()) > 0


def test_a_part_of_a_record_is_left_out(path):
    """After a loss of power; the older part ends with one, too."""
    old_part(path).write_bytes(b"aaabbbc")
    path.write_bytes(b"dddee")
    assert read(path, 3) == b"aaabbbddd"
    path.write_bytes(b"whole\nhalf")
    assert read(path) == b"whole\n"


def test_large_files_come_in_pieces_of_whole_records(path, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.io.rolling_file.CHUNK", 10)
    path.write_bytes(b"aaabbbcccdddeeefff")
    pieces = list(read_rolling(path, 3))
    assert [len(piece) % 3 for piece in pieces] == [0] * len(pieces)
    assert len(pieces) > 1
    assert b"".join(pieces) == path.read_bytes()


def test_what_cannot_be_read_is_named(path):
    path.mkdir()
    with pytest.raises(InputError, match=re.escape(f"{path}: cannot read the file: Is a directory")):
        read(path)
