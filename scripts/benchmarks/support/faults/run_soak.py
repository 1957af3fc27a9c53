#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Drives for long in an environment with ROS, with a fault every minute: run_soak.py MINUTES RATE DRIVES RESULT."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Dict, List, TextIO, Tuple

import numpy as np
import rospy
from support.faults.catalogue import FAULTS
from support.faults.drive import Drive, whole_lap
from support.faults.live import READY_S, Live
from support.faults.machine_faults import save
from support.faults.robot import LiveRobot
from support.faults.shuttle import Shuttle
from support.faults.system import NODES, LiveSystem, wait_until
from support.faults.witness import Witness
from support.ros_processes import running

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.simulation.bag import files_beside

# One of them in each minute, all of them in a quarter of an hour.
INJECTED = (
    *("frozen", "flash", "wheels_silent", "torn", "wheel_slips", "dark", "standing", "silent", "lamps_toggle"),
    *("not_numbers", "noise", "hand", "against_a_wall", "wrong_encoding", "saved"),
)
CALM_S = 20.0  # before the end of a minute the faults are long over
LISTENER = Path(__file__).with_name("pose_listener.py")
BEFORE_S, AFTER_S = 10.0, 1.0  # saving
CONNECTED_S = 5.0  # of the time before; the listener needs the rest to connect
GIVES_UP_S = 60.0  # roslaunch has killed its nodes long before


@dataclass
class Minute:
    """How the nodes are at the end of a minute of driving.

    Attributes:
        fault: that was injected in it.
        resident_mb, threads, descriptors: of each node.
        latency_ms: 95th percentile of the time from a wheel sample to its pose, in the calm part.
        calm_share: share of the outputs of the calm part whose state is good.
        reasons: how many of the others gave which reasons.
        error_m: of the pose since the drive began.
        sigmas: that error, by the covariance that was published.
    """

    fault: str
    resident_mb: Dict[str, float]
    threads: Dict[str, int]
    descriptors: Dict[str, int]
    latency_ms: float
    calm_share: float
    reasons: Dict[str, int]
    error_m: float
    sigmas: float


@dataclass
class End:
    """What happens after the last minute.

    Attributes:
        save_s: how long fusion_node took to save its trajectories while it went on.
        usual_gap_ms: longest time between two of its outputs in the seconds before.
        save_gap_ms: the same while it saved.
        interrupt_s: from SIGINT to roslaunch until it had ended; infinite if it did not.
        poses: lines of the files that were left then, by name.
    """

    save_s: float
    usual_gap_ms: float
    save_gap_ms: float
    interrupt_s: float
    poses: Dict[str, int]


def main() -> int:
    """Drive; each minute is written when it is over."""
    minutes, rate = int(sys.argv[1]), float(sys.argv[2])
    drives, result = Path(sys.argv[3]), Path(sys.argv[4])
    drive = whole_lap(drives)
    kept = result.parent / "kept"
    robot_file = str(files_beside(drive.bag)["robot"])
    arguments = {"robot": robot_file, "respawn": "false", "trajectory_dir": str(kept)}
    log_file = result.with_name("nodes.log")
    with log_file.open("w") as log, LiveSystem(dict(os.environ), arguments, log, ()) as system:
        system.set_parameter("/use_sim_time", True)
        launched = system.launch()
        rospy.init_node("soak", disable_signals=True)
        robot = LiveRobot(Shuttle(Drive(drive)), True, True, rate)
        live = Live(robot, system, Witness(), result.parent)
        wait_until(robot.is_heard, READY_S, "the nodes do not listen")
        found: Dict[str, List[Dict[str, object]]] = {"minutes": []}
        with robot:
            for number in range(minutes):
                fault = INJECTED[number % len(INJECTED)] if number else "nothing"
                found["minutes"].append(asdict(_minute(live, 60.0 * number, fault)))
                result.write_text(json.dumps(found, indent=1))
            robot.rate = 1.0  # as a robot drives: now times count
            saved = _saved(live, result.parent, log)
        interrupt_s = _interrupted_s(launched)
        end = End(*saved, interrupt_s, {path.name: _poses(path) for path in sorted(kept.glob("*.tum"))})
        result.write_text(json.dumps({**found, "end": asdict(end)}, indent=1))
    return 0


def _saved(live: Live, folder: Path, log: TextIO) -> Tuple[float, float, float]:
    """Seconds that fusion_node takes to save, and its longest silence before and meanwhile in milliseconds."""
    heard = folder / "arrivals.json"
    with running([sys.executable, str(LISTENER), str(heard)], dict(os.environ), log):
        time.sleep(BEFORE_S)
        start_s = time.monotonic()
        answer = save("fusion_node", folder / "saved")
        end_s = time.monotonic()
        if not answer.success:
            raise OSError(answer.message)
        time.sleep(AFTER_S)
    arrivals_s = np.array(json.loads(heard.read_text()))
    gaps_s = np.diff(arrivals_s)
    before = (arrivals_s[1:] > start_s - CONNECTED_S) & (arrivals_s[1:] < start_s)
    meanwhile = (arrivals_s[1:] >= start_s) & (arrivals_s[:-1] < end_s + AFTER_S)
    return end_s - start_s, 1e3 * float(gaps_s[before].max()), 1e3 * float(gaps_s[meanwhile].max())


def _interrupted_s(launched: subprocess.Popen) -> float:
    """Seconds from SIGINT to the end of roslaunch; infinite if it does not end."""
    start_s = time.monotonic()
    launched.send_signal(signal.SIGINT)
    try:
        launched.wait(GIVES_UP_S)
    except subprocess.TimeoutExpired:
        return np.inf
    return time.monotonic() - start_s


def _poses(path: Path) -> int:
    return sum(not line.startswith("#") for line in path.read_text().splitlines())


def _minute(live: Live, begin_s: float, fault: str) -> Minute:
    """A minute of driving, with a fault in its first half."""
    _drive_until(live, begin_s + 10.0)
    FAULTS[fault].script(live)
    _drive_until(live, begin_s + 60.0 - CALM_S)
    calm_s = time.monotonic()
    _drive_until(live, begin_s + 60.0)
    processes = {node: Path(f"/proc/{live.system.pid(node)}") for node in NODES}
    latency_ms, error_m, sigmas = _quality(live, calm_s)
    calm = [status for arrival_s, status in live.witness.fused if arrival_s > calm_s]
    states = [status.state == status.CONVERGED for status in calm]
    reasons = Counter("; ".join(status.reasons) for status, good in zip(calm, states) if not good)
    live.witness.forget()
    live.robot.forget()
    return Minute(
        fault,
        {node: int((process / "statm").read_text().split()[1]) * 4096 / 1e6 for node, process in processes.items()},
        {node: len(list((process / "task").iterdir())) for node, process in processes.items()},
        {node: len(list((process / "fd").iterdir())) for node, process in processes.items()},
        latency_ms,
        float(np.mean(states)) if states else 0.0,
        dict(reasons),
        error_m,
        sigmas,
    )


def _drive_until(live: Live, time_s: float) -> None:
    while live.robot.driven_s < time_s:
        time.sleep(0.02)


def _quality(live: Live, calm_s: float) -> Tuple[float, float, float]:
    """Latency, error since the beginning, and that error in sigmas, of the outputs of the calm part."""
    outputs = [o for o in live.witness.outputs if o.arrival_s > calm_s and o.stamp_ns in live.robot.sent]
    if not outputs:
        return np.inf, np.inf, np.inf
    latencies_ms = [1e3 * (output.arrival_s - live.robot.sent_s[output.stamp_ns]) for output in outputs]
    last = outputs[-1]
    truth = planar.between(live.robot.start, live.robot.sent[last.stamp_ns])
    error = (last.pose - truth)[:2]
    sigmas = float(np.sqrt(error @ np.linalg.solve(last.covariance, error)))
    return float(np.percentile(latencies_ms, 95)), float(np.hypot(*error)), sigmas


if __name__ == "__main__":
    sys.exit(main())
