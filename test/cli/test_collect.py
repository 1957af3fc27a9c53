# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.trajectory import read_tum


def published(path, topic):
    with BagWriter(path) as writer:
        for second in range(1, 4):
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
    assert str(bag) in capsys.readouterr().err
