# SPDX-License-Identifier: BSD-3-Clause
"""Nodes that are killed, doubled, or without a master."""

import signal
from typing import Callable, Dict

from support.faults.live import Live
from support.faults.outcome import Fault
from support.faults.wheel_faults import SILENCE_GAP_S

GROUP = "processes"


def killed(node: str, number: int = signal.SIGKILL) -> Callable[[Live], None]:
    """Script that kills a node, and waits until roslaunch has started it again."""

    def script(live: Live) -> None:
        live.system.kill(node, number)
        live.system.wait_for_another(node)

    return script


def killed_while_standing(live: Live) -> None:
    """fusion_node, while no new keyframe comes."""
    live.robot.standing = True
    live.drive(1.0)
    killed("fusion_node")(live)
    live.drive(1.0)
    live.robot.standing = False


def core_gone(live: Live) -> None:
    """Roscore dies, and another one starts."""
    live.system.kill_core()
    live.drive(2.0)
    live.system.start_core()
    live.drive(1.0)


def two_instances(live: Live) -> None:
    """Somebody launches the nodes a second time, with the same names."""
    before = live.system.pids()
    live.system.launch("respawn:=false")
    for node in before:
        live.system.killed[node] = before[node] or 0
        live.system.wait_for_another(node)
    live.drive(2.0)


# wheel_odometry_node begins at the origin again; the pose goes on.
FAULTS: Dict[str, Fault] = {
    "kill_dso": Fault(
        GROUP,
        "kill -9 of dso_node while it tracks",
        killed("dso_node"),
        "silent",
        1.2,
        is_blind=True,
        ends=("dso_node",),
        recovers_s=15.0,
    ),
    "kill_dso_early": Fault(
        GROUP,
        "kill -9 of dso_node before its first map",
        killed("dso_node"),
        is_blind=True,
        ends=("dso_node",),
        recovers_s=20.0,
        at_start=True,
    ),
    "kill_wheels": Fault(
        GROUP,
        "kill -9 of wheel_odometry_node",
        killed("wheel_odometry_node"),
        "silent|wheels",
        1.2,
        gap_s=SILENCE_GAP_S,
        ends=("wheel_odometry_node",),
    ),
    "kill_fusion": Fault(
        GROUP,
        "kill -9 of fusion_node when the scale is known",
        killed("fusion_node"),
        ends=("fusion_node",),
        gap_s=10.0,
        recovers_s=15.0,
        begins_anew=True,
    ),
    "kill_fusion_early": Fault(
        GROUP,
        "kill -9 of fusion_node before the scale is known",
        killed("fusion_node"),
        ends=("fusion_node",),
        gap_s=10.0,
        recovers_s=20.0,
        at_start=True,
        begins_anew=True,
    ),
    "kill_fusion_standing": Fault(
        GROUP,
        "kill -9 of fusion_node while the robot stands",
        killed_while_standing,
        ends=("fusion_node",),
        gap_s=10.0,
        recovers_s=15.0,
        begins_anew=True,
    ),
    "terminate_dso": Fault(
        GROUP,
        "SIGTERM to dso_node",
        killed("dso_node", signal.SIGTERM),
        "silent",
        1.2,
        is_blind=True,
        ends=("dso_node",),
        recovers_s=15.0,
    ),
    "core_gone": Fault(GROUP, "roscore is gone for 2 s and comes back", core_gone),
    "two_instances": Fault(
        GROUP,
        "the nodes are launched a second time",
        two_instances,
        gap_s=10.0,
        recovers_s=20.0,
        begins_anew=True,
        ends=("dso_node", "wheel_odometry_node", "fusion_node"),
        arguments={"respawn": "false"},
    ),
}
