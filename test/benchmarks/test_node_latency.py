# SPDX-License-Identifier: BSD-3-Clause
"""What `scripts/bench speed` says of messages that have arrived, and how they arrive from nodes that really run."""

import os

import pytest
from support import ros_processes
from support.node_latency import Heard, play
from support.ros_processes import ros_environment, running
from support.table import Row

from ceiling_dso_ros.experiments.rendered_drives import RenderedDrives
from ceiling_dso_ros.simulation.bag import files_beside
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig

PERIOD_NS = 100_000_000
BEGIN_NS = 1_700_000_000_000_000_000
IMAGES = {BEGIN_NS + k * PERIOD_NS: 5.0 + 0.1 * k for k in range(60)}


def after(delay_s, first, *without):
    """Arrivals from an image on, each so long after its image."""
    return {stamp_ns: s + delay_s for k, (stamp_ns, s) in enumerate(IMAGES.items()) if k >= first and k not in without}


def test_latency_is_from_an_image_to_its_own_pose():
    poses = {**after(0.004, 10), **after(0.05, 57)}
    heard = Heard(IMAGES, poses, after(0.005, 0))
    assert heard.latency_ms(50.0) == pytest.approx(4.0, abs=1e-6)
    assert heard.latency_ms(100.0) == pytest.approx(50.0, abs=1e-6)
    assert len(heard.latencies_ms()) == 50


def test_only_images_between_the_first_pose_and_the_end_count_as_dropped():
    poses, before, behind = after(0.004, 10, 20, 21), range(3, 8), (58, 59)
    heard = Heard(IMAGES, poses, after(0.005, 0, *before, 20, 21, *behind))
    assert heard.dropped_percent() == pytest.approx(100.0 * 2 / 39)


def test_an_image_that_was_looked_at_in_vain_is_not_dropped():
    heard = Heard(IMAGES, after(0.004, 10, 20, 21), after(0.005, 0))
    assert heard.dropped_percent() == 0.0


def test_a_node_that_falls_silent_has_dropped_the_rest():
    half = {stamp_ns: s for stamp_ns, s in after(0.004, 10).items() if s < 7.95}
    assert Heard(IMAGES, half, half).dropped_percent() > 40.0


@pytest.mark.parametrize("heard", [Heard({}, {}, {}), Heard(IMAGES, {}, after(0.005, 0))])
def test_without_a_pose_no_limit_holds(heard):
    for value in (heard.latency_ms(50.0), heard.dropped_percent()):
        assert not Row("", "", [value], high=1e9).holds


def test_a_missing_workspace_is_told_in_a_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ros_processes, "SETUP", tmp_path / "setup.bash")
    assert ros_environment(tmp_path) is None
    assert capsys.readouterr().err.count("\n") == 1


def test_a_process_ends_with_its_block(tmp_path):
    command, environment = ["sleep", "1000"], dict(os.environ)
    with (tmp_path / "log").open("w") as log:
        with running(command, environment, log) as process:
            assert process.poll() is None
        assert process.returncode < 0
        with pytest.raises(KeyError), running(command, environment, log) as process:
            raise KeyError
        assert process.returncode < 0


@pytest.mark.ros
@pytest.mark.long
def test_nodes_publish_a_pose_of_what_they_have_seen(tmp_path):
    environment = ros_environment(tmp_path / "ros")
    if environment is None:
        pytest.skip("needs ROS and the built workspace")
    camera = CameraModel(width=424, height=240, fps=15.0)
    drive = RenderedDrives(tmp_path).drive(SimulationConfig("loops", "factory", camera=camera, duration_s=8.0))
    heard = play(drive.bag, files_beside(drive.bag)["robot"], environment)
    assert len(heard.images) == len(drive.recording)
    assert len(heard.poses) > 50
    assert set(heard.poses) <= set(heard.statuses) <= set(heard.images)
    assert heard.latency_ms(50.0) > 0.0  # a single camera_info may be heard later than its pose
    assert heard.dropped_percent() < 100.0
