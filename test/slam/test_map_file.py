# SPDX-License-Identifier: BSD-3-Clause
import io
import json
import os
import re
import subprocess
import sys
import time
import zipfile
from dataclasses import replace

import numpy as np
import painted_ceiling as ceiling
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.slam.map_file import HEAD, map_bytes, read_map, require_camera, write_map
from ceiling_dso_ros.slam.records import RecordCamera
from ceiling_dso_ros.slam.site_map import Edge, MapKeyframe, SiteMap


@pytest.fixture(scope="module")
def site():
    texture = ceiling.paint(20)
    poses = [np.array([0.4 * i, 0.1, 0.2]) for i in range(3)]
    keyframes = tuple(MapKeyframe(ceiling.record(texture, pose, i), pose, 0) for i, pose in enumerate(poses))
    edges = tuple(Edge(i, i + 1, np.array([0.4, 0.0, 0.0]), 1e-6 * np.eye(3), i == 1) for i in range(2))
    return SiteMap(ceiling.RECORD_CAMERA, keyframes, edges)


def test_save_load_save_gives_the_same_bytes(site, tmp_path):
    write_map(tmp_path / "site", site)
    loaded = read_map(tmp_path / "site")
    assert map_bytes(loaded) == (tmp_path / "site").read_bytes()
    np.testing.assert_array_equal(loaded.keyframes[2].record.points, site.keyframes[2].record.points)
    np.testing.assert_array_equal(loaded.keyframes[1].record.tilt, site.keyframes[1].record.tilt)
    assert loaded.edges[1].is_loop
    require_camera("site", loaded, ceiling.RECORD_CAMERA)


SAVE_FOR_EVER = """
import sys
from ceiling_dso_ros.slam.map_file import read_map, write_map
site = read_map(sys.argv[1])
print("saving", flush=True)
while True:
    write_map(sys.argv[1], site)
"""


@pytest.mark.long
@pytest.mark.parametrize("delay_s", [0.0, 0.07, 0.23])
def test_what_is_killed_while_it_saves_leaves_a_whole_map(site, tmp_path, delay_s):
    path = tmp_path / "site"
    write_map(path, site)
    before = path.read_bytes()
    command = [sys.executable, "-c", SAVE_FOR_EVER, str(path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as saving:
        assert saving.stdout.readline() == b"saving\n"
        time.sleep(delay_s)
        saving.kill()
    assert path.read_bytes() == before
    assert len(read_map(path).keyframes) == 3
    write_map(path, site)  # what it has left beside it is in nobody's way
    assert [each.name for each in tmp_path.iterdir()] == ["site"]


def test_an_empty_map_can_be_kept(tmp_path):
    write_map(tmp_path / "site", SiteMap(ceiling.RECORD_CAMERA, (), ()))
    assert read_map(tmp_path / "site").keyframes == ()


def test_a_truncated_or_changed_file_is_refused_in_one_line(site, tmp_path):
    content = map_bytes(site)
    path = tmp_path / "site"
    damaged = [content[: len(content) * share // 8] for share in range(8)]
    for place in range(60, len(content), len(content) // 12):
        damaged.append(content[:place] + bytes([content[place] ^ 0x5A]) + content[place + 1 :])
    for number, text in enumerate([b"no map\n", *damaged]):
        path.write_bytes(text)
        with pytest.raises(InputError, match="site") as caught:
            read_map(path)
        assert "\n" not in str(caught.value), number


def rewritten(content, name, change):
    """The archive with one entry changed."""
    target = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as archive, zipfile.ZipFile(target, "w") as changed:
        for entry in archive.namelist():
            data = archive.read(entry)
            changed.writestr(entry, change(data) if entry == name else data)
    return target.getvalue()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"version": 99}, "update the package"),
        ({"version": 1}, "build it again"),
        ({"kind": "another"}, "no map"),
        ({"camera": [1.0]}, "no map"),
    ],
)
def test_another_version_or_kind_is_named(site, tmp_path, change, reason):
    path = tmp_path / "site"
    path.write_bytes(rewritten(map_bytes(site), HEAD, lambda data: json.dumps({**json.loads(data), **change}).encode()))
    with pytest.raises(InputError, match=reason):
        read_map(path)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("pose.npy", lambda data: data.replace(b"'shape': (3, 3)", b"'shape': (3, 3 ")),  # numpy tokenizes it
        ("pose.npy", lambda data: data.replace(b"'shape': (3, 3)", b"'shape': (-3,-3)")),
        (HEAD, lambda data: data.replace(b"212", b"1e999", 1)),
        (HEAD, lambda data: b"[" * 100_000),
        (HEAD, lambda data: re.sub(rb'("T_base_camera": \[\[)[-+.0-9e]+', rb"\1NaN", data)),
    ],
)
def test_contents_that_make_no_sense_are_refused_in_one_line(site, tmp_path, name, change):
    path = tmp_path / "site"
    changed = rewritten(map_bytes(site), name, change)
    assert changed != rewritten(map_bytes(site), name, lambda data: data)
    path.write_bytes(changed)
    with pytest.raises(InputError, match="is no map, or is damaged") as caught:
        read_map(path)
    assert "\n" not in str(caught.value)


def test_edges_to_nowhere_are_refused(site, tmp_path):
    write_map(tmp_path / "site", replace(site, edges=(site.edges[0]._replace(end=7),)))
    with pytest.raises(InputError, match="is damaged"):
        read_map(tmp_path / "site")


def test_an_array_that_declares_more_than_there_is_takes_no_memory(site, tmp_path):
    content = map_bytes(site)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (10**15, 3)})
    (tmp_path / "site").write_bytes(rewritten(content, "point.npy", lambda _: header.getvalue()))
    with pytest.raises(InputError, match="another size than it declares"):
        read_map(tmp_path / "site")


def test_another_camera_or_mount_is_refused(site):
    other = RecordCamera(site.camera.camera, ceiling.mount(roll=0.1))
    with pytest.raises(InputError, match="another camera or mount"):
        require_camera("site", site, other)
