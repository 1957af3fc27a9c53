# SPDX-License-Identifier: BSD-3-Clause
"""ROS's own tools take a simulated bag as it is: rosbag info, rosbag play through a roscore, rostopic hz, tf."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import xmlrpc.client
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from waiting import PATIENCE_S, wait_until

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.simulation.bag import write_measurements
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

TOOLS = ("roscore", "rosbag", "rostopic")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(not all(map(shutil.which, TOOLS)), reason=f"needs {', '.join(TOOLS)} of a ROS installation"),
]

LISTENER = Path(__file__).with_name("bag_listener.py")


@pytest.fixture(scope="module")
def recording():
    camera = CameraModel(width=212, height=120)
    return SimulatedRecording(SimulationConfig("square", "plaster", camera=camera, duration_s=6.0))


@pytest.fixture(scope="module")
def bag(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("played") / "drive.bag"
    with BagWriter(path) as bag:
        write_measurements(bag, recording, recording.simulation.measurements())
    return path


@pytest.fixture(scope="module")
def ros(tmp_path_factory):
    """Environment of a roscore of our own, with simulated time."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    uri = f"http://127.0.0.1:{port}"
    logs = str(tmp_path_factory.mktemp("log"))
    environment = {**os.environ, "ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": logs}
    environment.pop("ROS_HOSTNAME", None)
    core = subprocess.Popen(["roscore", "-p", str(port)], env=environment, stdout=subprocess.DEVNULL)
    master = xmlrpc.client.ServerProxy(uri)
    try:
        wait_until(lambda: master.getPid("/test")[0] == 1, process=core)
        master.setParam("/test", "/use_sim_time", True)
        yield environment
    finally:
        core.send_signal(signal.SIGINT)
        core.wait(PATIENCE_S)


@pytest.fixture(scope="module")
def played(bag, ros):
    """What a listener and `rostopic hz` got while the bag was played."""
    listener = subprocess.Popen([sys.executable, str(LISTENER)], env=ros, stdout=subprocess.PIPE, text=True)
    rate = subprocess.Popen(
        ["rostopic", "hz", "/camera/up/image_raw"],
        env={**ros, "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    play = ["rosbag", "play", "--quiet", "--clock", "--wait-for-subscribers", str(bag)]
    subprocess.run(play, env=ros, check=True, timeout=PATIENCE_S, stdin=subprocess.DEVNULL)
    time.sleep(1.0)  # the last messages are on their way
    for process in (listener, rate):
        process.send_signal(signal.SIGINT)
    heard, rates = (process.communicate(timeout=PATIENCE_S)[0] for process in (listener, rate))
    return json.loads(heard), [float(number) for number in re.findall(r"average rate: ([0-9.]+)", rates)]


def test_every_message_arrives(played, recording):
    counts = played[0]["counts"]
    images, wheels = len(recording), len(recording.simulation.encoders.time_s)
    expected = {f"/camera/up/{name}": images for name in ("image_raw", "camera_info", "exposure")}
    for topic in ("/joint_states", "/wheel/left/ticks", "/wheel/right/ticks", "/odom", "/ground_truth"):
        expected[topic] = wheels
    assert counts.pop("/scan") == pytest.approx(60, abs=1)
    assert counts == expected


def test_images_come_at_the_rate_of_the_camera(played):
    assert played[1], "rostopic hz saw none"
    assert played[1][-1] == pytest.approx(30.0, rel=0.1)


def test_tf_knows_where_the_camera_is(played, recording):
    for frames, T in (
        ("base_link camera_up_optical_frame", recording.robot.T_base_camera),
        ("base_link laser", recording.simulation.robot.static_transforms()["laser"]),
    ):
        values = played[0]["transforms"][frames]
        np.testing.assert_allclose(values[:3], T[:3, 3], atol=1e-9)
        np.testing.assert_allclose(Rotation.from_quat(values[3:]).as_matrix(), T[:3, :3], atol=1e-9)
    assert played[0]["transforms"]["map odom"][:2] == pytest.approx(
        recording.simulation.robot.motion.poses(0.0)[0, :2].tolist()
    )


def test_rosbag_info_takes_it_as_it_is(bag, recording):
    info = subprocess.run(["rosbag", "info", str(bag)], capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    images = re.search(r"/camera/up/image_raw\s+(\d+) msgs", info.stdout)
    assert int(images[1]) == len(recording)
    assert "rosbag reindex" not in info.stdout + info.stderr
