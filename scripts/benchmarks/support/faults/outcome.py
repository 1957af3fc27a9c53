# SPDX-License-Identifier: BSD-3-Clause
"""What a fault asks for, what was seen, and whether that is what was asked for."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Callable, Dict, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.fusion import planar

if TYPE_CHECKING:
    from support.faults.live import Live

GAP_S = 0.5  # between two outputs; a planner stops at about that
JUMP_M, JUMP_RAD = 0.05, 0.03  # beyond the motion: half a cell of a costmap
ERROR_M = 0.03  # over the fault and what follows, when somebody still sees
RECOVERY_S = 8.0


@dataclass(frozen=True)
class Fault:
    """A fault and what is asked of the nodes.

    Attributes:
        group: what is at fault.
        injected: in words.
        script: injects it and returns when it is over.
        says: regular expression of what must be said; empty: nothing needs to.
        within_s: how soon it must be said.
        gap_s: longest time between two outputs.
        jump_m, jump_rad: largest step of the pose beyond the motion.
        is_blind: the wheels alone carry the robot meanwhile: its error is bounded by theirs.
        losses: maps that may be lost.
        recovers_s: how soon after the fault the state must be good again.
        at_start: it is injected before the scale is known.
        ends: nodes whose process does not survive.
        events: of the simulator, in the drive.
        arguments: of the launch file.
        simulated_clock: the nodes run with /use_sim_time.
        shifted_clock: the realtime clock is set.
        mount: the camera's mount is known from the beginning.
        small_disk: the nodes see a disk that is soon full, `machine_faults.FULL_DISK`.
        own_kernels: the compiled kernels are copied to a cache that the fault may remove.
        begins_anew: the pose may begin anew, so that neither jump nor error are judged.
    """

    group: str
    injected: str
    script: Callable[["Live"], None]
    says: str = ""
    within_s: float = 1.0
    gap_s: float = GAP_S
    jump_m: float = JUMP_M
    jump_rad: float = JUMP_RAD
    is_blind: bool = False
    losses: float = 0
    recovers_s: float = RECOVERY_S
    at_start: bool = False
    ends: Tuple[str, ...] = ()
    events: Tuple[str, ...] = ()
    arguments: Dict[str, str] = field(default_factory=dict)
    simulated_clock: bool = False
    shifted_clock: bool = False
    mount: bool = True
    small_disk: bool = False
    own_kernels: bool = False
    begins_anew: bool = False


@dataclass
class Outcome:
    """What was seen.

    Attributes:
        said_after_s: seconds until what must be said was said; None: never, or nothing needs to.
        gap_s: longest time between two outputs.
        jump_m, jump_rad: largest step beyond the motion.
        error_m, wheels_m: of the motion from the fault to the end, of the output and of the wheels alone.
        losses: of maps.
        recovered_after_s: None: never.
        problems: all that is not as it must be.
    """

    said_after_s: Optional[float] = None
    gap_s: float = np.nan
    jump_m: float = np.nan
    jump_rad: float = np.nan
    error_m: float = np.nan
    wheels_m: float = np.nan
    losses: int = 0
    recovered_after_s: Optional[float] = None
    problems: List[str] = field(default_factory=list)

    def judge(self, fault: Fault) -> None:
        """Find what is not as the fault asks for."""
        if fault.says and (self.said_after_s is None or self.said_after_s > fault.within_s):
            when = "never" if self.said_after_s is None else f"after {self.said_after_s:.1f} s"
            self.problems.append(f"said {when}, not within {fault.within_s:g} s")
        if not self.gap_s <= fault.gap_s:
            self.problems.append(f"no output for {self.gap_s:.2f} s")
        if self.recovered_after_s is None or self.recovered_after_s > fault.recovers_s:
            self.problems.append("not recovered in time")
        if self.losses > fault.losses:
            self.problems.append(f"{self.losses} maps lost")
        if fault.begins_anew:
            return
        if not (self.jump_m <= fault.jump_m and self.jump_rad <= fault.jump_rad):
            self.problems.append(f"jump of {1e3 * self.jump_m:.0f} mm, {self.jump_rad:.3f} rad")
        limit_m = max(ERROR_M, self.wheels_m) if fault.is_blind else ERROR_M
        if not self.error_m <= limit_m:
            self.problems.append(f"{1e3 * self.error_m:.0f} mm off, limit {1e3 * limit_m:.0f}")


def largest_jump(poses: np.ndarray, truth: np.ndarray) -> Tuple[float, float]:
    """Largest step from pose to pose beyond the true one, metres and radians, of (N, 3) each."""
    if len(poses) < 2:
        return np.nan, np.nan
    errors = np.array(
        [
            planar.between(planar.between(*true), planar.between(*step))
            for true, step in zip(_steps(truth), _steps(poses))
        ]
    )
    return float(np.hypot(*errors[:, :2].T).max()), float(np.abs(errors[:, 2]).max())


def motion_error_m(start: np.ndarray, end: np.ndarray, true_start: np.ndarray, true_end: np.ndarray) -> float:
    """Distance between where a motion leads and where the true one leads, all (3,) poses."""
    error = planar.between(start, end)[:2] - planar.between(true_start, true_end)[:2]
    return float(np.linalg.norm(error))


def _steps(poses: np.ndarray) -> "zip[Tuple[np.ndarray, np.ndarray]]":
    return zip(poses[:-1], poses[1:])
