# SPDX-License-Identifier: BSD-3-Clause
"""The process that streams a camera, and reports to the one that started it.

The library may hang or crash when a camera is unplugged or reset. So it is loaded here alone, and this process is
killed and started again where it does not report in time.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from contextlib import closing, suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue

from ceiling_dso_ros.drivers.realsense_stream import RealsenseStream
from ceiling_dso_ros.drivers.reports import (
    CameraError,
    Command,
    Connected,
    Expose,
    InertialReadings,
    Remark,
    Report,
    ResetDevice,
    Waiting,
)
from ceiling_dso_ros.drivers.settings import CameraSettings

SEARCH_PERIOD_S = 0.3
IMAGE_TIMEOUT_S = 1.0
MISSES = 3  # images that do not come, before the camera is started anew
# How long the other process waits for the next report.
STREAMING_PATIENCE_S, STARTING_PATIENCE_S, RESET_PATIENCE_S = 2.5, 10.0, 30.0
END_PATIENCE_S = 2.0  # that the library has to stop streaming
PR_SET_PDEATHSIG = 1


class Streaming:
    """Looks for the camera, streams it, and looks for it again.

    Args:
        connection: to the other process, whose first message is the CameraSettings.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._settings: CameraSettings = connection.recv()
        self._commands: SimpleQueue[Command] = SimpleQueue()
        self._ended = threading.Event()
        threading.Thread(target=self._receive, name="commands", daemon=True).start()

    def go_on(self) -> None:
        """Work until the other process hangs up."""
        while not self._ended.is_set():
            self._find_and_stream()
            time.sleep(SEARCH_PERIOD_S)

    def _receive(self) -> None:
        while True:
            try:
                self._commands.put(self._connection.recv())
            except (EOFError, OSError):
                break
        self._ended.set()
        time.sleep(END_PATIENCE_S)
        os._exit(0)  # the library does not return

    def _report(self, report: Report) -> None:
        self._connection.send(report)

    def _find_and_stream(self) -> None:
        try:
            stream = RealsenseStream(self._settings)
        except CameraError as error:
            self._report(Waiting(str(error), STARTING_PATIENCE_S))
            return
        with closing(stream):
            try:
                reason = self._stream(stream)
            except CameraError as error:
                reason = str(error)
            self._report(Waiting(reason, STARTING_PATIENCE_S))

    def _stream(self, stream: RealsenseStream) -> str:
        """Stream until the camera has to be started anew; returns why.

        Raises:
            CameraError: it is gone.
        """
        self._report(Connected(stream.camera))
        misses = 0
        while not self._ended.is_set():
            captured = stream.capture(IMAGE_TIMEOUT_S)
            if captured is not None:
                misses = 0
                self._report(captured)
            else:
                misses += 1
                stream.require_connected()
                text = f"camera {stream.camera.serial_no} gives no image for {misses * IMAGE_TIMEOUT_S:g} s"
                if misses == MISSES:
                    return f"{text}, it is started anew"
                self._report(Waiting(text, STREAMING_PATIENCE_S))
            readings = stream.readings()
            if readings:
                self._report(InertialReadings(readings))
            reason = self._obey(stream)
            if reason:
                return reason
        return "nobody listens"

    def _obey(self, stream: RealsenseStream) -> str:
        """Do as told next, if anything; returns why the camera has to be started anew, or nothing.

        Raises:
            CameraError: it is gone.
        """
        try:
            command = self._commands.get_nowait()
        except Empty:
            return ""
        if isinstance(command, ResetDevice):
            self._report(Waiting(f"camera {stream.camera.serial_no} is reset", RESET_PATIENCE_S))
            stream.reset()
            return f"camera {stream.camera.serial_no} was reset"
        return self._expose(stream, command)

    def _expose(self, stream: RealsenseStream, command: Expose) -> str:
        before, now = self._settings.exposure, command.exposure
        self._settings = replace(self._settings, exposure=now)
        if (before.limit_ms, before.gain_limit) != (now.limit_ms, now.gain_limit):
            return "the camera is started anew with other limits of exposure"  # they count from the start on
        for complaint in stream.expose(now):
            self._report(Remark(complaint))
        return ""


def main() -> None:
    """Stream for the process at the other end of the connection whose descriptor is the argument."""
    # A library that hangs with the interpreter's lock must not keep the camera for ever.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the other process, which ends this one
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # the other process has ended
        Streaming(Connection(int(sys.argv[1]))).go_on()
    os._exit(0)  # at once: the library's threads may not let the interpreter end


if __name__ == "__main__":
    main()
