# SPDX-License-Identifier: BSD-3-Clause
"""A machine that is busy, full or without its caches, and nodes that end while they save."""

import shutil
import signal
import threading
from pathlib import Path
from typing import Callable, Dict

import rospy
from support.faults.live import Live
from support.faults.outcome import Fault
from support.faults.system import wait_until

from ceiling_dso_ros.srv import SaveTrajectory, SaveTrajectoryResponse

GROUP = "machine"
FULL_DISK = "/tmp/ceiling_dso_full_disk"  # a file system of 64 kB that only the nodes see


def save(node: str, folder: Path) -> SaveTrajectoryResponse:
    """Ask a node to save its trajectories."""
    rospy.wait_for_service(f"{node}/save_trajectory", 10.0)
    return rospy.ServiceProxy(f"{node}/save_trajectory", SaveTrajectory)(str(folder))


def busy(live: Live) -> None:
    """Two loops on a machine."""
    with live.system.busy(2):
        live.drive(5.0)


def saved(live: Live) -> None:
    """Save while driving."""
    for node in ("fusion_node", "dso_node"):
        answer = save(node, live.folder / node)
        live.check(answer.success, f"{node}: {answer.message}")
        live.check(any((live.folder / node).glob("*.tum")), f"{node} has written nothing")
    live.drive(1.0)


def saved_to(folder: str, reason: str) -> Callable[[Live], None]:
    """Script that saves where it cannot be saved."""

    def script(live: Live) -> None:
        answer = save("fusion_node", Path(folder))
        live.check(not answer.success, f"saved to {folder}")
        live.check(reason in answer.message, f"instead of '{reason}': {answer.message}")
        live.drive(1.0)

    return script


def ended_while_saving(number: int) -> Callable[[Live], None]:
    """Script: fusion_node ends while it writes; what is there afterwards is whole."""

    def script(live: Live) -> None:
        folder = live.folder / "saved"
        thread = threading.Thread(target=_save_in_vain, args=(folder,), daemon=True)
        thread.start()
        live.drive(0.05)
        live.system.kill("fusion_node", number)
        live.system.wait_for_another("fusion_node")
        for path in folder.glob("*"):
            complete = path.suffix == ".tum" and path.read_text().endswith("\n")
            live.check(complete or number == signal.SIGKILL, f"{path.name} is not whole")
            live.check(path.suffix != ".tum" or complete, f"{path.name} is not whole")

    return script


def _save_in_vain(folder: Path) -> None:
    try:
        save("fusion_node", folder)
    except (rospy.ServiceException, rospy.ROSException):
        return


def no_kernels(live: Live) -> None:
    """The compiled kernels are gone when dso_node starts again."""
    cache = Path(live.system.environment["NUMBA_CACHE_DIR"])
    shutil.rmtree(cache)
    live.system.kill("dso_node")
    wait_until(lambda: live.witness.has_converged(), 600.0, "dso_node does not come back")


FAULTS: Dict[str, Fault] = {
    "busy": Fault(GROUP, "two busy loops for 5 s", busy, is_blind=True),
    "saved": Fault(GROUP, "save_trajectory of both nodes while driving", saved),
    "save_read_only": Fault(
        GROUP, "save_trajectory to a place where nothing can be written", saved_to("/proc/x", "/proc/x")
    ),
    "save_full": Fault(GROUP, "save_trajectory to a full disk", saved_to(FULL_DISK, "space"), small_disk=True),
    "disk_fills": Fault(
        GROUP,
        "the trajectories are kept on a disk that is full after seconds",
        lambda live: live.drive(12.0),
        "No space left",
        13.0,
        small_disk=True,
        arguments={"trajectory_dir": FULL_DISK},
    ),
    "no_kernels": Fault(
        GROUP,
        "the compiled kernels are gone when dso_node is killed",
        no_kernels,
        "compil|silent",
        5.0,
        is_blind=True,
        ends=("dso_node",),
        own_kernels=True,
    ),
    "save_terminated": Fault(
        GROUP,
        "SIGTERM while fusion_node saves",
        ended_while_saving(signal.SIGTERM),
        ends=("fusion_node",),
        gap_s=10.0,
        recovers_s=15.0,
        begins_anew=True,
    ),
    "save_killed": Fault(
        GROUP,
        "kill -9 while fusion_node saves",
        ended_while_saving(signal.SIGKILL),
        ends=("fusion_node",),
        gap_s=10.0,
        recovers_s=15.0,
        begins_anew=True,
    ),
}
