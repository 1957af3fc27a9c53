# SPDX-License-Identifier: BSD-3-Clause
"""A drive, and playback.launch on a roscore of its own, for the tests of this folder."""

import os
import signal
import socket
import subprocess
import time
import xmlrpc.client
from pathlib import Path

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.simulation.bag import files_beside, write_files_beside, write_measurements
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

PATIENCE_S = 300.0
SLOWLY = 0.2  # so that no image is dropped


def render_drive(path):
    """Eight seconds of driving, with small images."""
    recording = SimulatedRecording(
        SimulationConfig("loops", "factory", camera=CameraModel(width=424, height=240, fps=15.0), duration_s=8.0)
    )
    write_files_beside(path, recording)
    with BagWriter(path) as writer:
        write_measurements(writer, recording, recording.simulation.measurements())


class Launched:
    """playback.launch on a roscore of its own."""

    def __init__(self, bag, folder, *arguments, **environment):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = str(probe.getsockname()[1])
        uri = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(folder / "log")}
        self.environment = {**os.environ, **uri, **environment}
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
