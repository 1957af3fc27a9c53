# SPDX-License-Identifier: BSD-3-Clause
import itertools

import numpy as np
import pytest

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.trajectory import read_tum


def published(path, *topics):
    with BagWriter(path) as writer:
        for topic, second in itertools.product(topics, range(1, 4)):
            writer.odometry(topic, second * 10**9, "odom", "base_link", np.eye(4), np.zeros(3), np.zeros(3))
    return path


def test_what_was_published_becomes_files_that_evaluate_takes(tmp_path, capsys):
    bag = published(tmp_path / "published.bag", "/odometry/filtered")
    assert main(["collect", str(bag), "--out", str(tmp_path / "out")]) == 0
    assert len(read_tum(tmp_path / "out" / "fused.tum")) == 3
    assert "3 poses of /odometry/filtered" in capsys.readouterr().out


def test_other_topics_can_be_named(tmp_path):
    bag = published(tmp_path / "published.bag", "/robot/odom")
    assert main(["collect", str(bag), "--out", str(tmp_path), "--wheel-topic", "/robot/odom"]) == 0
    assert len(read_tum(tmp_path / "wheel.tum")) == 3


def test_bag_without_poses_is_refused(tmp_path, capsys):
    bag = published(tmp_path / "published.bag", "/elsewhere")
    assert main(["collect", str(bag), "--out", str(tmp_path)]) == 2
    complaint = capsys.readouterr().err
    assert f"{bag}: no poses on /visual_odometry/pose, " in complaint
    assert "it has others on /elsewhere, choose with --fused-topic" in complaint


def test_what_has_no_poses_is_said_where_other_topics_have(tmp_path, capsys):
    bag = published(tmp_path / "published.bag", "/odometry/filtered", "/robot/odom")
    assert main(["collect", str(bag), "--out", str(tmp_path / "out")]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert "no camera.tum, wheel.tum, mapped.tum: no poses on /visual_odometry/pose" in line
    assert "it has others on /robot/odom, choose with" in line


def test_folders_that_are_not_that_of_a_node(tmp_path, capsys):
    for name in ("fusion_node.20260101-000000.1.spool", "fusion_node.20260101-000000.2.spool"):
        (tmp_path / "kept" / name).mkdir(parents=True)
    for folder, complaint in ((tmp_path / "kept", "give one of them: "), (tmp_path, "whose name ends with .spool")):
        assert main(["collect", str(folder), "--out", str(tmp_path / "out")]) == 2
        assert complaint in capsys.readouterr().err


def test_the_folder_of_a_node_that_was_killed(tmp_path, capsys):
    from ceiling_dso_ros.fusion.config import FusionConfig
    from ceiling_dso_ros.playback.fusion_spool import FusionSpool
    from ceiling_dso_ros.playback.spool import SpoolFolder

    spool = FusionSpool(SpoolFolder(tmp_path, "fusion_node"), 10**6, FusionConfig()).path
    (spool / "fused.tum").write_text("1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 1\n")
    assert main(["collect", str(spool), "--out", str(tmp_path / "out")]) == 0
    assert f"{tmp_path / 'out' / 'fused.tum'}: 2 poses" in capsys.readouterr().out
    assert len(read_tum(tmp_path / "out" / "fused.tum")) == 2
    (tmp_path / "out" / "fused.tum").unlink()
    (tmp_path / "out" / "fused.tum").mkdir()
    assert main(["collect", str(spool), "--out", str(tmp_path / "out")]) == 1
    assert "fused.tum: cannot write the trajectory: Is a directory" in capsys.readouterr().err


@pytest.mark.parametrize("below", [".", "new"])
def test_nothing_is_written_where_a_node_keeps_its_results(tmp_path, capsys, below):
    spool = tmp_path / "fusion_node.20260101-000000.1.spool"
    spool.mkdir()
    (spool / "fused.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    (tmp_path / "link").symlink_to(spool)
    assert main(["collect", str(spool), "--out", str(tmp_path / "link" / below)]) == 2
    assert f"a node keeps its results in {spool}; choose a folder outside" in capsys.readouterr().err
    assert [path.name for path in spool.iterdir()] == ["fused.tum"]
