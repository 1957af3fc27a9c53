#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Runs one fault in an environment with ROS: run_fault.py NAME DRIVES OUTCOME. The outcome is written as json."""

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

import rospy
import yaml
from support.faults.catalogue import FAULTS
from support.faults.drive import Drive, rendered
from support.faults.live import Live, run
from support.faults.machine_faults import FULL_DISK
from support.faults.outcome import Fault, Outcome
from support.faults.robot import LiveRobot
from support.faults.system import LiveSystem, ShiftedClock
from support.faults.witness import Witness

from ceiling_dso_ros.simulation.bag import files_beside

# A file system that only the nodes see; it needs the right to mount, or user name spaces.
SMALL_DISK = (
    *("unshare", "--map-root-user", "--mount", "sh", "-c"),
    f'mkdir -p {FULL_DISK} && mount -t tmpfs -o size=64k none {FULL_DISK} && exec "$@"',
    "sh",
)


def main() -> int:
    """Run the fault that the command line names."""
    name, drives, result = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    outcome = inject(FAULTS[name], drives, result.parent)
    result.write_text(json.dumps(asdict(outcome), indent=1))
    return 0


def inject(fault: Fault, drives: Path, folder: Path) -> Outcome:
    """Everything from the start of roscore to the verdict; what the processes print is logged in the folder."""
    drive = rendered(drives, *fault.events)
    arguments = {**fault.arguments, "robot": str(_robot_file(files_beside(drive.bag)["robot"], folder, fault.mount))}
    clock = ShiftedClock(folder) if fault.shifted_clock else None
    log_file, prefix = folder / "nodes.log", SMALL_DISK if fault.small_disk else ()
    with log_file.open("w") as log, LiveSystem(dict(os.environ), arguments, log, prefix) as system:
        if fault.simulated_clock:
            system.set_parameter("/use_sim_time", True)
        system.launch()
        rospy.init_node("faults", disable_signals=True)
        robot = LiveRobot(Drive(drive), fault.simulated_clock, fault.mount)
        live = Live(robot, system, Witness(), folder, clock)
        try:
            return run(fault, live)
        except (TimeoutError, rospy.ROSException) as error:
            return Outcome(problems=[*live.problems, str(error)])


def _robot_file(nominal: Path, folder: Path, has_mount: bool) -> Path:
    """The robot's file, with the camera's mount or without."""
    values = yaml.safe_load(nominal.read_text())
    if not has_mount:
        del values["T_base_camera"]
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


if __name__ == "__main__":
    sys.exit(main())
