# SPDX-License-Identifier: BSD-3-Clause
import re

import numpy as np
import pytest

from ceiling_dso_ros.io.bag_reader import open_bag, read_messages
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.errors import FrameError, InputError


@pytest.fixture
def path(tmp_path):
    with BagWriter(tmp_path / "tour.bag") as bag:
        for index in range(9):
            bag.image("/image", 10**9 + index, "camera", np.full((500, 1000), index, np.uint8))
            bag.ticks("/ticks", 10**9 + index, index)
    return tmp_path / "tour.bag"


def test_messages_of_some_topics_in_order(path):
    assert [raw.content().data for raw in read_messages(path, ["/ticks"])] == list(range(9))
    raws = list(read_messages(path, ["/image", "/ticks"]))
    assert [raw.stamp_ns - 10**9 for raw in raws] == [index for index in range(9) for _ in range(2)]
    assert list(read_messages(path, ["/nothing"])) == []


def test_bytes_that_are_no_message(path):
    (raw, *_) = read_messages(path, ["/image"])
    with pytest.raises(FrameError, match="damaged message of 100 bytes"):
        raw._replace(data=raw.data[:100]).content()


@pytest.mark.parametrize("share", [0.0005, 0.01, 0.3, 0.7, 0.9999])
def test_a_bag_that_was_cut_off(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=re.escape(f"{path}: the bag is not indexed or damaged (")) as caught:
        list(read_messages(path, ["/image"]))
    assert str(caught.value).endswith("'rosbag reindex' may repair it")
    assert "\n" not in str(caught.value)


def test_a_bag_that_was_not_closed(path, tmp_path):
    writer = BagWriter(tmp_path / "open.bag")
    for index in range(5):
        writer.image("/image", 10**9 + index, "camera", np.zeros((500, 1000), np.uint8))
    active = tmp_path / "open.bag.active"
    with pytest.raises(InputError, match="not indexed or damaged"):
        list(read_messages(active, ["/image"]))


@pytest.mark.parametrize("seed", range(40))
def test_random_damage_never_ends_in_another_error(path, seed):
    rng = np.random.default_rng(seed)
    content = bytearray(path.read_bytes())
    index = content.rfind(b"chunk_pos=") if seed % 2 else 4096  # damage the index, or the first chunk's header
    for position in rng.integers(index - 300, min(index + 300, len(content)), 20):
        content[position] = rng.integers(256)
    path.write_bytes(bytes(content))
    try:
        for raw in read_messages(path, ["/image"]):
            raw.content()
    except (InputError, FrameError) as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("content", [b"", b"SQLite format 3\x00", b"#ROSBAG V1.2\n", b"\xff\xfe\x00"])
def test_files_of_other_kinds(tmp_path, content):
    path = tmp_path / "other.bag"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(f"{path}: is not a ROS 1 bag (format 2.0)")), open_bag(path):
        pass


def test_a_folder_is_no_bag(tmp_path):
    with pytest.raises(InputError, match="cannot read the bag: Is a directory"), open_bag(tmp_path):
        pass
