# SPDX-License-Identifier: BSD-3-Clause
"""One fault on the live system: start everything, drive, inject, watch, judge."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional

import numpy as np
from support.faults.outcome import Fault, Outcome, largest_jump, motion_error_m
from support.faults.robot import LiveRobot
from support.faults.system import LiveSystem, ShiftedClock, wait_until
from support.faults.witness import Output, Witness

CONVERGES_S = 40.0
WATCHED_S = 3.0  # at least, after the fault
READY_S = 300.0  # also when the kernels must be compiled


@dataclass
class Live:
    """What a fault's script works with.

    Attributes:
        robot: that drives.
        system: the nodes.
        witness: what they say.
        folder: for files.
        problems: what a script has found wrong by itself.
        clock: the machine's, where the fault sets it.
    """

    robot: LiveRobot
    system: LiveSystem
    witness: Witness
    folder: Path
    clock: Optional[ShiftedClock] = None

    def __post_init__(self) -> None:
        self.problems: List[str] = []

    def drive(self, seconds: float) -> None:
        """Drive on for so long, in the time of the drive."""
        time.sleep(seconds / self.robot.rate)

    def check(self, holds: bool, otherwise: str) -> None:
        """Note a problem."""
        if not holds:
            self.problems.append(otherwise)


def run(fault: Fault, live: Live) -> Outcome:
    """Inject the fault into nodes that have been started, and judge.

    Raises:
        TimeoutError: the nodes do not start, or do not find the scale without the fault.
    """
    outcome = Outcome(problems=live.problems)
    wait_until(live.robot.is_heard, READY_S, "the nodes do not listen")
    pids = live.system.pids()
    with live.robot:
        wait_until(lambda: len(live.witness.outputs) > 0, READY_S, "no output")
        if not fault.at_start:
            wait_until(live.witness.has_converged, CONVERGES_S, f"no scale: {live.witness.fused[-1:]}")
            live.drive(1.0)
        first, start_s = len(live.witness.outputs) - 1, time.monotonic()
        fault.script(live)
        end_s = time.monotonic()
        outcome.recovered_after_s = _recovery_s(fault, live, end_s)
        live.drive(max(0.0, end_s + WATCHED_S - time.monotonic()))
        outputs = live.witness.outputs[first:]
    outcome.gap_s = _longest_gap_s(outputs)
    _compare_with_truth(outcome, live, outputs)
    outcome.losses = sum(arrival_s >= start_s and s.state == s.LOST for arrival_s, s in live.witness.visual)
    if fault.says:
        outcome.said_after_s = live.witness.said_after_s(fault.says, start_s)
    live.check(all(output.is_finite for output in outputs), "numbers that are not finite, or no variances")
    for node, pid in pids.items():
        live.check(node in fault.ends or Path(f"/proc/{pid}").exists(), f"{node} has ended")
    outcome.judge(fault)
    return outcome


def _recovery_s(fault: Fault, live: Live, end_s: float) -> Optional[float]:
    """Seconds until the state is good for good; None: not in time."""
    give_up_s = end_s + fault.recovers_s + 1.0
    while time.monotonic() < give_up_s:
        since_s = live.witness.converged_since(end_s)
        if since_s is not None:
            return since_s - end_s
        time.sleep(0.05)
    return None


def _longest_gap_s(outputs: List[Output]) -> float:
    if len(outputs) < 2:
        return np.inf
    return float(np.diff([output.arrival_s for output in outputs]).max())


def _compare_with_truth(outcome: Outcome, live: Live, outputs: List[Output]) -> None:
    """Jumps and errors, over the outputs at stamps that were sent."""
    known = [output for output in outputs if output.stamp_ns in live.robot.sent]
    if len(known) < 2:
        return
    truth = np.array([live.robot.sent[output.stamp_ns] for output in known])
    outcome.jump_m, outcome.jump_rad = largest_jump(np.array([output.pose for output in known]), truth)
    outcome.error_m = motion_error_m(known[0].pose, known[-1].pose, truth[0], truth[-1])
    wheels = live.witness.wheel_poses
    stamps_ns = [output.stamp_ns for output in known if output.stamp_ns in wheels]
    if len(stamps_ns) >= 2:
        first_ns, last_ns = stamps_ns[0], stamps_ns[-1]
        sent = live.robot.sent
        outcome.wheels_m = motion_error_m(wheels[first_ns], wheels[last_ns], sent[first_ns], sent[last_ns])
