"""A simulated bag through playback.launch: what comes out live is what `run` gets offline, and bags may be looped."""

import os
import shutil
import signal
import socket
import subprocess
import time
import xmlrpc.client
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")

from evo.tools import file_interface
from rosbags.rosbag1 import Reader

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.bag_trajectories import read_trajectories
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.simulation.bag import files_beside, write_files_beside, write_measurements
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

TOOLS = ("roslaunch", "rosbag", "rostopic")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(not all(map(shutil.which, TOOLS)), reason=f"needs {', '.join(TOOLS)} of a ROS installation"),
]
PATIENCE_S = 300.0
SLOWLY = 0.2  # so that no image is dropped


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Eight seconds of driving, with small images; in a folder whose name takes some care."""
    path = tmp_path_factory.mktemp("drive") / 'it\'s "a" drive' / "drive.bag"
    path.parent.mkdir()
    recording = SimulatedRecording(
        SimulationConfig("loops", "factory", camera=CameraModel(width=424, height=240, fps=15.0), duration_s=8.0)
    )
    write_files_beside(path, recording)
    with BagWriter(path) as writer:
        write_measurements(writer, recording, recording.simulation.measurements())
    return path


class Launched:
    """playback.launch on a roscore of its own."""

    def __init__(self, bag, folder, *arguments):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = str(probe.getsockname()[1])
        uri = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(folder / "log")}
        self.environment = {**os.environ, **uri}
        self.environment.pop("ROS_HOSTNAME", None)
        self.published = folder / "what's published.bag"
        command = ["roslaunch", "-p", port, "ceiling_dso_ros", "playback.launch", f"bag:={bag}"]
        command += [f"robot:={files_beside(bag)['robot']}", f"record:={self.published}", *arguments]
        self.process = subprocess.Popen(
            command, env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True
        )

    def wait(self):
        self.process.wait(PATIENCE_S)

    def interrupt(self):
        """As Ctrl-C does."""
        self.process.send_signal(signal.SIGINT)
        self.wait()

    def value(self, field):
        """What `rostopic echo` says of a topic's field now."""
        echo = ["rostopic", "echo", "-n", "1", field]
        try:
            answer = subprocess.run(echo, env=self.environment, capture_output=True, text=True, timeout=10.0)
        except subprocess.TimeoutExpired:
            return ""
        return answer.stdout.split("\n")[0]

    def cpu_s(self, node):
        """Seconds of processor time that a node has used so far."""
        master = xmlrpc.client.ServerProxy(self.environment["ROS_MASTER_URI"])
        pid = xmlrpc.client.ServerProxy(master.lookupNode("/test", node)[2]).getPid("/test")[2]
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")

    def wait_for(self, field, value):
        deadline = time.monotonic() + PATIENCE_S
        while self.value(field) != value:
            assert self.process.poll() is None, "roslaunch has ended"
            assert time.monotonic() < deadline, f"{field} does not become {value}"


def test_live_and_offline_agree(bag, tmp_path):
    live, offline = tmp_path / "poses of the nodes", tmp_path / "offline"
    launched = Launched(bag, tmp_path, f"rate:={SLOWLY}", "mapping:=sequential", f"trajectory_dir:={live}")
    launched.wait()
    assert main(["run", str(bag), "--out", str(offline)]) == 0

    images = read_tum(offline / "camera.tum"), read_tum(live / "camera.tum")
    assert len(images[0]) > 50
    np.testing.assert_array_equal(images[1].stamps_ns, images[0].stamps_ns, err_msg="images were dropped")
    np.testing.assert_allclose(images[1].positions, images[0].positions, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(images[1].quaternions_xyzw, images[0].quaternions_xyzw, rtol=0.0, atol=1e-9)

    fused = read_tum(offline / "fused.tum"), read_trajectories(launched.published, {"": "/odometry/filtered"})[""]
    _, first, second = np.intersect1d(fused[0].stamps_ns, fused[1].stamps_ns, return_indices=True)
    assert len(first) > 0.95 * len(fused[0])
    apart_m = np.linalg.norm(fused[0].positions[first] - fused[1].positions[second], axis=1)
    assert apart_m.max() < 1e-3

    for topic, poses in (("/odometry/filtered", fused[1]), ("/visual_odometry/pose", images[1])):
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
        assert launched.value("/visual_odometry/status/segment") == "0"
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
