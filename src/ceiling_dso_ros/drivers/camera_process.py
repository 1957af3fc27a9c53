# SPDX-License-Identifier: BSD-3-Clause
"""Runs the process that streams a camera, and starts it again whatever happens to it."""

import os
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Callable, Optional, Sequence

from ceiling_dso_ros.drivers.reports import CapturedImages, Command, Expose, Report, ResetDevice, Waiting
from ceiling_dso_ros.drivers.settings import CameraSettings, ExposureSettings

FIRST_PATIENCE_S = 20.0  # the library is loaded
PATIENCE_S = 2.5  # as long as reports with images come
END_PATIENCE_S = 1.0
LONGEST_PAUSE_S = 5.0  # before the process is started once more, if it ends again and again without an image

STREAM = (sys.executable, "-m", "ceiling_dso_ros.drivers.streaming")


class CameraProcess:
    """Streams a camera in another process; may be killed, and its camera unplugged, at any time.

    Attributes:
        starts: how often the process was started.
    """

    def __init__(
        self, settings: CameraSettings, handle: Callable[[Report], None], command: Sequence[str] = STREAM
    ) -> None:
        """Prepare it.

        Args:
            settings: which camera streams what.
            handle: is given every report, in a thread of its own.
            command: that starts the process; the descriptor of the connection is added.
        """
        self.starts = 0
        self._settings, self._handle, self._command = settings, handle, tuple(command)
        self._lock = threading.Lock()  # of the connection, for those who send
        self._connection: Optional[Connection] = None
        self._process: Optional[subprocess.Popen] = None
        self._closed, self._has_streamed = threading.Event(), False
        self._thread = threading.Thread(target=self._go_on, name="camera", daemon=True)

    def start(self) -> None:
        """Begin to stream."""
        self._thread.start()

    def close(self) -> None:
        """End the process."""
        self._closed.set()
        with self._lock:
            if self._connection is not None:
                with socket.fromfd(self._connection.fileno(), socket.AF_UNIX, socket.SOCK_STREAM) as ends:
                    ends.shutdown(socket.SHUT_RDWR)  # wakes both processes, which closing does not
        if self._thread.is_alive():
            self._thread.join()

    @property
    def pid(self) -> Optional[int]:
        """Number of the process; None while there is none."""
        process = self._process
        return None if process is None else process.pid

    def expose(self, exposure: ExposureSettings) -> None:
        """Expose in another way from now on, also after the process was started anew."""
        self._settings = replace(self._settings, exposure=exposure)
        self._send(Expose(exposure))

    def reset_device(self) -> bool:
        """Restart the camera itself; False while the process is not there."""
        return self._send(ResetDevice())

    def _send(self, command: Command) -> bool:
        with self._lock:
            if self._connection is None:
                return False
            try:
                self._connection.send(command)
            except OSError:  # it has just ended
                return False
            return True

    def _go_on(self) -> None:
        pause_s = 0.0
        while not self._closed.is_set():
            self._has_streamed = False
            try:
                reason = self._run()
            except OSError as error:  # the computer has no memory or no descriptors left
                reason = f"the streaming process cannot be started: {error}"
            if self._closed.is_set():
                return
            pause_s = 0.0 if self._has_streamed else min(LONGEST_PAUSE_S, 2.0 * pause_s + 0.1)
            self._handle(Waiting(f"{reason}; it is started again", FIRST_PATIENCE_S))
            self._sleep(pause_s)

    def _run(self) -> str:
        """Run the process once; returns why it has ended."""
        ours, theirs = Pipe()
        # The package may be found by a path that only this process has.
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        process = subprocess.Popen(
            [*self._command, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # Ctrl-C is for this process
        )
        theirs.close()
        self.starts += 1
        with self._lock:
            self._process, self._connection = process, ours
        try:
            if self._closed.is_set():
                return ""
            ours.send(self._settings)
            return self._listen(ours)
        except (EOFError, OSError):  # it has ended, or `close` was called
            return f"the streaming process has ended with code {_exit_code(process, END_PATIENCE_S)}"
        finally:
            _exit_code(process, 0.0)
            with self._lock:
                self._process = self._connection = None
            ours.close()

    def _listen(self, connection: Connection) -> str:
        """Pass on what it says, until it says nothing for too long."""
        patience_s = FIRST_PATIENCE_S
        while connection.poll(patience_s):
            report = connection.recv()
            self._has_streamed = self._has_streamed or isinstance(report, CapturedImages)
            patience_s = report.patience_s if isinstance(report, Waiting) else PATIENCE_S
            self._handle(report)
        return f"the streaming process has said nothing for {patience_s:g} s"

    def _sleep(self, duration_s: float) -> None:
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s and not self._closed.is_set():
            time.sleep(0.02)


def _exit_code(process: subprocess.Popen, patience_s: float) -> int:
    """The exit code of a process, which is killed if it does not end in time."""
    try:
        return process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()
