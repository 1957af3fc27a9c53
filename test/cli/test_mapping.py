# SPDX-License-Identifier: BSD-3-Clause
import cv2
import matplotlib.colors
import numpy as np
import pytest

from ceiling_dso_ros.cli.main import DONE, WRONG_INPUT, main
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.evaluation.map_figure import WAY_COLOURS
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.io.trajectory import Trajectory, write_tum
from ceiling_dso_ros.slam.map_file import write_map
from ceiling_dso_ros.slam.records import Corners, KeyframeRecord, RecordCamera
from ceiling_dso_ros.slam.site_map import Edge, MapKeyframe, SiteMap

MOUNT = np.eye(4)
MOUNT[2, 3] = 0.6


@pytest.fixture
def site(tmp_path):
    """The file of a map of three keyframes in a row, with a loop."""
    rng = np.random.default_rng(0)
    keyframes = []
    for number in range(3):
        points = np.column_stack([rng.uniform(-1, 1, (20, 2)), np.full(20, 3.0)]).astype(np.float32)
        corners = Corners(points[:4], rng.integers(0, 2**60, (4, 4)).astype(np.uint64))
        image = rng.integers(0, 256, (72, 96)).astype(np.uint8)
        pose = np.array([0.8 * number, 0.0, 0.1])
        record = KeyframeRecord(
            number, pose, 1e-6 * np.eye(3), image, points, corners, Tilt(np.zeros(2), np.full(2, 1e-3))
        )
        keyframes.append(MapKeyframe(record, pose, 0))
    edges = (
        Edge(0, 1, np.array([0.8, 0.0, 0.0]), 1e-6 * np.eye(3), False),
        Edge(0, 2, np.array([1.6, 0.0, 0.0]), 1e-6 * np.eye(3), True),
    )
    camera = RecordCamera(PinholeCamera(60.0, 60.0, 47.5, 35.5, 96, 72), MOUNT)
    path = tmp_path / "hall.site"
    write_map(path, SiteMap(camera, tuple(keyframes), edges))
    return path


def test_a_map_can_be_seen(site, tmp_path, capsys):
    pictures = [tmp_path / "hall.png", tmp_path / "again.png"]
    for picture in pictures:
        assert main(["map", "info", str(site), "--picture", str(picture)]) == DONE
    text = capsys.readouterr().out
    assert "3 keyframes of 1 drives in 1.6 x 0.0 m, 1 loops" in text
    assert "3.0 to 3.0 m above the floor" in text
    assert cv2.imread(str(pictures[0])).std() > 10.0
    assert pictures[0].read_bytes() == pictures[1].read_bytes()


def test_ways_in_a_map_can_be_seen(site, tmp_path, capsys):
    way, pictures = tmp_path / "mapped.tum", [tmp_path / "hall.png", tmp_path / "with_way.png"]
    stamps_ns = np.arange(1, 4) * 10**9
    positions = np.array([[0.5, 0.5, 0.0], [1.0, 0.5, 0.0], [1.5, 0.6, 0.0]])
    write_tum(way, Trajectory(stamps_ns, positions, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))))
    assert main(["map", "info", str(site), "--picture", str(pictures[0])]) == DONE
    assert main(["map", "info", str(site), "--picture", str(pictures[1]), "--way", str(way)]) == DONE
    way_colour = np.array(matplotlib.colors.to_rgb(WAY_COLOURS[1]))[::-1] * 255
    without, with_way = (
        int((np.abs(cv2.imread(str(picture)) - way_colour).max(axis=2) < 20).sum()) for picture in pictures
    )
    assert without < 10 < 50 < with_way
    assert main(["map", "info", str(site), "--way", str(way)]) == WRONG_INPUT
    assert "name its file with --picture" in capsys.readouterr().err


def test_a_picture_of_another_kind_is_refused(site, capsys):
    assert main(["map", "info", str(site), "--picture", "hall.jpg"]) == WRONG_INPUT
    assert ".png or .svg" in capsys.readouterr().err


def test_a_map_of_another_camera_is_refused_before_a_run(site, wheeled_folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["run", str(wheeled_folder), "--map", str(site), "--out", str(out)]) == WRONG_INPUT
    assert "another camera or mount" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("command", [["map", "info", "{}"], ["map", "localise", "x", "--map", "{}", "--out", "o"]])
def test_what_is_no_map_is_refused_in_one_line(command, tmp_path, capsys):
    path = tmp_path / "site"
    for content in (None, b"", b"PK\x03\x04 no map"):
        if content is not None:
            path.write_bytes(content)
        assert main([word.format(path) for word in command]) == WRONG_INPUT
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_recording_without_wheels_gives_no_map(tum_folder, tmp_path, capsys):
    assert main(["map", "build", str(tum_folder), "--out", str(tmp_path / "site")]) == WRONG_INPUT
    assert "has no wheels" in capsys.readouterr().err
    assert not (tmp_path / "site").exists()
