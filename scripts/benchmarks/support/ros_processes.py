# SPDX-License-Identifier: BSD-3-Clause
"""Processes on a separate roscore, with the catkin workspace of this checkout; all are ended."""

import os
import shutil
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Dict, Iterator, Optional, Sequence, TextIO

from support.checkout import CHECKOUT

SETUP = CHECKOUT / ".ws" / "devel" / "setup.bash"
TOOLS = ("roslaunch", "rosbag")
SETUP_TIMEOUT_S = 60.0
END_TIMEOUT_S = 120.0  # roslaunch gives each of its nodes 17 s
WITH_THIS_PROCESS = ("setpriv", "--pdeathsig", "TERM")  # ends a command even when this process is killed

Environment = Dict[str, str]


def ros_environment(log_folder: Path) -> Optional[Environment]:
    """Environment of the workspace's nodes, with a roscore on a free port.

    None, and a message, if ROS or the workspace is missing.

    Args:
        log_folder: where the nodes write their logs.
    """
    environment = _workspace_environment() if SETUP.is_file() else {}
    if not all(shutil.which(tool, path=environment.get("PATH", "")) for tool in TOOLS):
        print(f"{SETUP} or ROS is missing, nodes are not measured: scripts/bootstrap sets both up", file=sys.stderr)
        return None
    environment.pop("ROS_HOSTNAME", None)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        environment["ROS_MASTER_URI"] = f"http://127.0.0.1:{probe.getsockname()[1]}"
    return {**environment, "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(log_folder.resolve())}


@contextmanager
def running(command: Sequence[str], environment: Environment, log: TextIO) -> Iterator[subprocess.Popen]:
    """A process that is interrupted like by Ctrl-C when the block ends; its output goes to the log.

    Raises:
        OSError: it cannot be started.
    """
    process = subprocess.Popen(
        [*WITH_THIS_PROCESS, *command],
        env=environment,
        start_new_session=True,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _workspace_environment() -> Environment:
    """Environment after sourcing the workspace; empty if that fails."""
    command = ["bash", "-c", 'source "$0" >&2 && env --null', str(SETUP)]
    sourced = subprocess.run(command, stdout=subprocess.PIPE, timeout=SETUP_TIMEOUT_S, text=True)
    variables = dict(entry.split("=", 1) for entry in sourced.stdout.split("\0") if entry)
    # ROS's own scripts ask for any python3: this one has what the nodes need.
    path = os.pathsep.join([str(Path(sys.executable).parent), variables.get("PATH", "")])
    return {**variables, "PATH": path} if sourced.returncode == 0 else {}
