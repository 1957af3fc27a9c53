# SPDX-License-Identifier: BSD-3-Clause
"""A simulated bag through playback.launch: what comes out live is what `run` gets offline, and bags may be looped."""

import shutil
import subprocess
import time

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")

from evo.tools import file_interface
from launched import PATIENCE_S, SLOWLY, Launched
from rosbags.rosbag1 import Reader

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.fusion.config import OutputConfig
from ceiling_dso_ros.io.bag_trajectories import read_trajectories
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.io.warning_log import WarningLog, ignore_warning
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.mapping import MappedDrive, build
from ceiling_dso_ros.playback.playback import Playback
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.simulation.bag import files_beside
from ceiling_dso_ros.slam.builder import SiteBuilder
from ceiling_dso_ros.slam.map_file import read_map

LATEST_S = 0.1  # by which a correction may be late, in the bag's time
TOOLS = ("roslaunch", "rosbag", "rostopic")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(not all(map(shutil.which, TOOLS)), reason=f"needs {', '.join(TOOLS)} of a ROS installation"),
]


def offline_map(bag):
    """As `map build` makes it, but for the prediction."""
    recording = open_recording(bag, robot_file=files_beside(bag)["robot"])
    fusion = FusionPlayback.of(recording)
    playback = Playback(VisualRun.of(recording), WarningLog(ignore_warning), fusion, predict=False, keep_keyframes=True)
    playback.play(recording.frames(wheels=recording.wheels))
    drive = MappedDrive.of(playback, fusion, bag)
    builder = SiteBuilder(drive.camera)
    build(builder, drive)
    return builder.site()


def assert_same_map(live, offline):
    assert len(offline.keyframes) >= 3
    stamps = [[keyframe.record.stamp_ns for keyframe in site.keyframes] for site in (live, offline)]
    assert stamps[0] == stamps[1]
    np.testing.assert_allclose(live.poses, offline.poses, rtol=0.0, atol=1e-3)
    for one, other in zip(live.keyframes, offline.keyframes):
        np.testing.assert_array_equal(one.record.image, other.record.image)
        np.testing.assert_allclose(one.record.points, other.record.points, rtol=0.0, atol=1e-3)


def test_live_and_offline_agree(bag, tmp_path):
    live, offline = tmp_path / "poses of the nodes", tmp_path / "offline"
    same = "mapping:=sequential", "motion_prediction:=false"
    site = tmp_path / "live.site"
    mapped = "localization:=true", f"save_map:={site}"
    launched = Launched(bag, tmp_path, f"rate:={SLOWLY}", *same, f"trajectory_dir:={live}", *mapped)
    launched.wait()
    assert_same_map(read_map(site), offline_map(bag))
    assert main(["run", str(bag), "--out", str(offline), "--no-prediction"]) == 0

    for name in ("camera", "keyframes", "wheel", "fused_smoothed"):
        poses = read_tum(offline / f"{name}.tum"), read_tum(live / f"{name}.tum")
        np.testing.assert_array_equal(poses[1].stamps_ns, poses[0].stamps_ns, err_msg=f"{name}: data were dropped")
        np.testing.assert_allclose(poses[1].positions, poses[0].positions, rtol=0.0, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(poses[1].quaternions_xyzw, poses[0].quaternions_xyzw, rtol=0.0, atol=1e-9)
    images = read_tum(live / "camera.tum")
    assert len(images) > 50

    # What is published moves on by wheels and images alike. Only the corrections may begin some wheel samples later,
    # since that takes computing; nothing is sent twice for that.
    fused = read_tum(offline / "fused.tum"), read_trajectories(launched.published, {"": "/odometry/filtered"})[""]
    _, first, second = np.intersect1d(fused[0].stamps_ns, fused[1].stamps_ns, return_indices=True)
    assert len(first) > 0.95 * len(fused[0])
    apart_m = np.linalg.norm(fused[0].positions[first] - fused[1].positions[second], axis=1)
    assert np.median(apart_m) < 1e-4
    assert apart_m.max() < LATEST_S * OutputConfig().max_correction_m_s

    for topic, poses in (("/odometry/filtered", fused[1]), ("/visual_odometry/pose", images)):
        with Reader(launched.published) as reader:  # as `evo_traj bag` does
            read = file_interface.read_bag_trajectory(reader, topic)
        np.testing.assert_allclose(read.positions_xyz, poses.positions, atol=1e-9)


def test_bag_that_is_looped_starts_anew(bag, tmp_path):
    launched = Launched(bag, tmp_path, "play_args:=--loop")
    heard = tmp_path / "stamps.csv"  # in the order of arrival, which a bag does not keep when its time goes back
    listen = ["rostopic", "echo", "-p", "/odometry/filtered/header/stamp"]
    try:
        launched.wait_for("/visual_odometry/status/state", "2")
        with heard.open("w") as file:
            listener = subprocess.Popen(listen, env=launched.environment, stdout=file)
        launched.wait_for("/fusion/status/resets", "1")
        launched.wait_for("/visual_odometry/status/state", "2")
        launched.wait_for("/visual_odometry/status/segment", "0")
        listener.terminate()
        listener.wait(PATIENCE_S)
    finally:
        launched.interrupt()
    stamps_s = [1e-9 * int(line.split(",")[1]) for line in heard.read_text().splitlines()[1:] if "," in line]
    steps_s = np.diff(stamps_s)
    assert (steps_s < 0.0).sum() == 1
    assert steps_s.min() < -5.0


def test_nothing_spins_while_the_clock_stands_still(bag, tmp_path):
    launched = Launched(bag, tmp_path)
    try:
        launched.wait_for("/visual_odometry/status/state", "2")
        pause = ["rosservice", "call", "/player/pause_playback", "true"]
        subprocess.run(pause, env=launched.environment, check=True, timeout=PATIENCE_S, stdout=subprocess.DEVNULL)
        time.sleep(1.0)  # what was under way
        nodes = ("/dso_node", "/fusion_node", "/wheel_odometry_node")
        before_s = [launched.cpu_s(node) for node in nodes]
        time.sleep(2.0)
        used_s = {node: launched.cpu_s(node) - before for node, before in zip(nodes, before_s)}
        assert max(used_s.values()) < 1.0, used_s
    finally:
        launched.interrupt()
