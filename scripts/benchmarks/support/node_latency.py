# SPDX-License-Identifier: BSD-3-Clause
"""Latency from an image's stamp to the published pose: a bag in real time through playback.launch, with the fusion."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List

import numpy as np
from support.ros_processes import Environment, running

LISTENER = Path(__file__).with_name("latency_listener.py")
PLAY_TIMEOUT_S = 600.0
END_NS = 1_000_000_000  # the nodes end with the bag and may not process its last images


@dataclass(frozen=True)
class Heard:
    """When messages arrived, in seconds of wall time, by their stamps in nanoseconds.

    An image's stamp, brought to wall time, is when `rosbag play` publishes its camera_info: a simulated bag records
    both at their common stamp. The camera_info is small and played first, so that reading and sending the image are
    part of the latency. The readout time of a real camera and delays of `rosbag play` are not.

    Attributes:
        images: camera_info.
        poses: visual_odometry/pose.
        statuses: visual_odometry/status, one for every image that was not dropped.
    """

    images: Dict[int, float]
    poses: Dict[int, float]
    statuses: Dict[int, float]

    def latencies_ms(self) -> List[float]:
        """Latency of each pose, from its image."""
        return [1e3 * (arrival_s - self.images[stamp_ns]) for stamp_ns, arrival_s in self.poses.items()]

    def latency_ms(self, percentile: float) -> float:
        """A percentile of the latencies, nan without poses."""
        latencies_ms = self.latencies_ms()
        return float(np.percentile(latencies_ms, percentile)) if latencies_ms else np.nan

    def dropped_percent(self) -> float:
        """Share of images after the first pose without a status, nan without any; the last second is left out."""
        first_ns, end_ns = min(self.poses, default=np.inf), max(self.images, default=0) - END_NS
        dropped = [stamp_ns not in self.statuses for stamp_ns in self.images if first_ns < stamp_ns <= end_ns]
        return 100.0 * float(np.mean(dropped)) if dropped else np.nan


def play(bag: Path, robot_file: Path, environment: Environment) -> Heard:
    """Play a bag through the nodes and listen; what they print goes to roslaunch.log in their folder of logs.

    Raises:
        OSError: something cannot be started, or the listener has left nothing.
        subprocess.TimeoutExpired: the nodes do not end with the bag.
    """
    folder = Path(environment["ROS_LOG_DIR"])
    folder.mkdir(parents=True, exist_ok=True)
    heard = folder / "heard.json"
    heard.unlink(missing_ok=True)
    _, _, port = environment["ROS_MASTER_URI"].rpartition(":")
    launch = ["roslaunch", "--port", port, "ceiling_dso_ros", "playback.launch"]
    launch += [f"bag:={bag.resolve()}", f"robot:={robot_file.resolve()}"]
    listen = [sys.executable, str(LISTENER), str(heard)]
    log_file = folder / "roslaunch.log"
    # The listener is ready long before the bag begins: it waits for the master alone, the bag for the nodes' kernels.
    with log_file.open("w") as log, running(listen, environment, log), running(launch, environment, log) as nodes:
        nodes.wait(PLAY_TIMEOUT_S)
    times = json.loads(heard.read_text())
    return Heard(**{name: {int(stamp_ns): s for stamp_ns, s in arrivals.items()} for name, arrivals in times.items()})
