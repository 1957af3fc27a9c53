# SPDX-License-Identifier: BSD-3-Clause
"""The nodes on a roscore of their own, which can be killed, doubled, starved and sent into the past."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, Optional, Sequence, TextIO, Union
from xmlrpc.client import ServerProxy

import numpy as np
from support.ros_processes import Environment, running

NODES = ("dso_node", "wheel_odometry_node", "fusion_node")
START_S = 60.0
CLOCK_SOURCE = Path(__file__).with_name("shifted_clock.c")
SHIFT_FILE = "clock_shift"


def wait_until(condition: Callable[[], bool], timeout_s: float, otherwise: str) -> None:
    """Wait until a condition holds.

    Raises:
        TimeoutError: it does not, with `otherwise`.
    """
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError(otherwise)
        time.sleep(0.02)


class ShiftedClock:
    """A realtime clock that can be set, for the processes of this benchmark alone.

    Processes that start with `prepare`'s environment read the machine's clock plus a shift that they share. The
    monotonic clock stays as it is, as on a robot whose clock is set.

    Args:
        folder: of `prepare`.
    """

    def __init__(self, folder: Path) -> None:
        self._shift_ns = np.memmap(folder / SHIFT_FILE, np.int64, "r+", shape=(1,))

    @staticmethod
    def prepare(folder: Path) -> Environment:
        """Environment of the processes; the library that shifts their clock is compiled to the folder."""
        library, shift = folder / "shifted_clock.so", folder / SHIFT_FILE
        subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", str(library), str(CLOCK_SOURCE), "-ldl"], check=True)
        shift.write_bytes(bytes(8))
        return {"LD_PRELOAD": str(library), "CLOCK_SHIFT_FILE": str(shift)}

    def shift(self, shift_s: float) -> None:
        """Set the clock forward, or back."""
        self._shift_ns[0] += round(shift_s * 1e9)
        self._shift_ns.flush()


class LiveSystem:
    """roscore and ceiling_odometry.launch.

    Args:
        environment: as `ros_environment` gives it.
        arguments: of the launch file.
        log: what all processes print.
        prefix: command that starts roslaunch.
    """

    def __init__(self, environment: Environment, arguments: Dict[str, str], log: TextIO, prefix: Sequence[str]) -> None:
        self.environment = environment
        self._log, self._prefix = log, list(prefix)
        self._port = environment["ROS_MASTER_URI"].rpartition(":")[2]
        self._arguments = [f"{name}:={value}" for name, value in {"respawn": "true", **arguments}.items()]
        self._master: Any = ServerProxy(environment["ROS_MASTER_URI"])  # whose methods are not known here
        self._stack = ExitStack()
        self._core: Optional[subprocess.Popen] = None
        self.killed: Dict[str, int] = {}  # node -> its process that has been killed

    def __enter__(self) -> "LiveSystem":
        self.start_core()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def start_core(self) -> None:
        """Start roscore, and wait until it answers."""
        self._core = self._run(["roscore", "-p", self._port])

        def answers() -> bool:
            try:
                return bool(self._master.getPid("/faults")[0] == 1)
            except OSError:
                return False

        wait_until(answers, START_S, "roscore does not answer")

    def kill_core(self) -> None:
        """End roscore at once, with the master."""
        assert self._core is not None
        # Master and rosout are in groups of their own.
        children = subprocess.run(["pgrep", "-P", str(self._core.pid)], stdout=subprocess.PIPE, check=True).stdout
        os.kill(self._core.pid, signal.SIGKILL)  # first, or it would end the others in good order
        self._core.wait()
        for child in map(int, children.split()):
            os.kill(child, signal.SIGKILL)

    def launch(self, *arguments: str) -> subprocess.Popen:
        """Start the nodes, or a second set of them."""
        command = ["roslaunch", "ceiling_dso_ros", "ceiling_odometry.launch", *self._arguments, *arguments]
        return self._run([*self._prefix, *command])

    def set_parameter(self, name: str, value: Union[bool, int, float, str]) -> None:
        """Set a parameter, before the nodes start."""
        self._master.setParam("/faults", name, value)

    def pid(self, node: str) -> Optional[int]:
        """A node's process, None if it does not answer."""
        try:
            uri = self._master.lookupNode("/faults", f"/{node}")[2]
            proxy: Any = ServerProxy(uri)
            return int(proxy.getPid("/faults")[2])
        except (OSError, ValueError, TypeError):
            return None

    def pids(self) -> Dict[str, Optional[int]]:
        """The processes of all nodes."""
        return {node: self.pid(node) for node in NODES}

    def kill(self, node: str, number: int = signal.SIGKILL) -> None:
        """Send a signal to a node; roslaunch starts it again."""
        pid = self.pid(node)
        if pid is None:
            raise TimeoutError(f"{node} does not answer")
        self.killed[node] = pid
        os.kill(pid, number)

    def wait_for_another(self, node: str) -> None:
        """Wait until a killed node is there again."""
        wait_until(lambda: self.pid(node) not in (None, self.killed[node]), START_S, f"{node} does not come back")

    @contextmanager
    def busy(self, loops: int) -> Iterator[None]:
        """While the block lasts, other processes use the machine."""
        with ExitStack() as stack:
            for _ in range(loops):
                stack.enter_context(running([sys.executable, "-c", "while True: pass"], self.environment, self._log))
            yield

    def _run(self, command: Sequence[str]) -> subprocess.Popen:
        return self._stack.enter_context(running(command, self.environment, self._log))
