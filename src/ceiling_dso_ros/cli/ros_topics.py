# SPDX-License-Identifier: BSD-3-Clause
"""Messages of ROS topics for a command, through a process that knows ROS."""

import importlib.util
import os
import subprocess
import sys
import threading
from multiprocessing import Pipe
from typing import TYPE_CHECKING, Callable, Optional, Sequence

from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.io.bag_writer import SerializedMessage

RELAY = "ceiling_dso_ros.ros.topic_relay"
END_PATIENCE_S = 2.0


class RosTopics:
    """Hands over every message of some topics, from a thread of its own.

    Args:
        topics: their names.
        handle: is given each message.

    Raises:
        InputError: there is no ROS or no master, from the constructor.
    """

    def __init__(self, topics: Sequence[str], handle: "Callable[[SerializedMessage], None]") -> None:
        self._handle = handle
        self._process: Optional[subprocess.Popen] = None
        if not topics:
            return
        if importlib.util.find_spec("rospy") is None:
            raise InputError(f"--topic {topics[0]}: needs ROS; source the workspace's devel/setup.bash")
        self._ours, theirs = Pipe()
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-m", RELAY, str(theirs.fileno()), *topics]
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env=environment, start_new_session=True, stdin=subprocess.DEVNULL
        )
        theirs.close()
        try:
            self._ours.recv()  # it has found ROS
        except EOFError:
            self.close()
            raise InputError("--topic: no ROS master answers; start roscore, or set ROS_MASTER_URI") from None
        threading.Thread(target=self._listen, name="topics", daemon=True).start()

    def close(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(END_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _listen(self) -> None:
        try:
            while True:
                self._handle(self._ours.recv())
        except (EOFError, OSError):
            return
