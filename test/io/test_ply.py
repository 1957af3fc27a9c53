# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.errors import OutputError
from ceiling_dso_ros.io.ply import PointCloud, write_ply

CLOUD = PointCloud(
    np.array([[0.1, -2.0, 3e5], [1e-3, 0.0, 7.0]]),
    np.array([99.6, 0.4], np.float32),
    np.array([0, 2]),
    np.array([5, 70_000]),
)


def test_what_is_written_comes_back(tmp_path, read_ply):
    write_ply(tmp_path / "a.ply", CLOUD)
    vertices = read_ply(tmp_path / "a.ply")
    names = ["x", "y", "z", "red", "green", "blue", "segment", "keyframe_id"]
    assert list(vertices) == names
    np.testing.assert_array_equal(
        np.column_stack([vertices[axis] for axis in "xyz"]), CLOUD.positions.astype(np.float32)
    )
    for channel in ("red", "green", "blue"):
        assert vertices[channel] == [100, 0]
    assert vertices["segment"] == [0, 2]
    assert vertices["keyframe_id"] == [5, 70_000]


def test_the_bytes(tmp_path):
    write_ply(tmp_path / "a.ply", PointCloud(np.ones((1, 3)), np.full(1, 7.0), np.full(1, 1), np.full(1, 258)))
    header, vertex = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert [line for line in lines[2:] if not line.startswith("comment ")] == [
        "element vertex 1",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        "property int segment",
        "property int keyframe_id",
    ]
    assert vertex == bytes.fromhex("0000803f" * 3 + "070707" + "01000000" + "02010000")


def test_grey_levels_beyond_the_range_are_limited(tmp_path, read_ply):
    grey = np.array([-3.0, 255.4, 300.0], np.float32)
    write_ply(tmp_path / "a.ply", PointCloud(np.zeros((3, 3)), grey, np.zeros(3, int), np.zeros(3, int)))
    assert read_ply(tmp_path / "a.ply")["green"] == [0, 255, 255]


def test_no_points(tmp_path, read_ply):
    write_ply(tmp_path / "a.ply", PointCloud(np.zeros((0, 3)), np.zeros(0), np.zeros(0, int), np.zeros(0, int)))
    assert read_ply(tmp_path / "a.ply")["x"] == []


def test_an_older_file_is_replaced_and_nothing_else_is_left(tmp_path, read_ply):
    (tmp_path / "a.ply").write_text("older and longer" * 100)
    write_ply(tmp_path / "a.ply", CLOUD)
    assert len(read_ply(tmp_path / "a.ply")["x"]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(OutputError, match=r"missing/a\.ply: cannot write the point cloud: No such file"):
        write_ply(tmp_path / "missing" / "a.ply", CLOUD)
