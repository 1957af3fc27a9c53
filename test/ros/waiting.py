# SPDX-License-Identifier: BSD-3-Clause
"""Waiting for nodes: tests ask for what happens, never for how fast."""

import time

PATIENCE_S = 180.0  # the first image may have to wait for compilation
SOON_S = 10.0  # well below PATIENCE_S, and above what a shared machine stands still for


def wait_until(condition, complaint="it takes too long", process=None):
    """Poll a condition, which may ask a node that does not answer yet, as long as a process runs."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            if condition():
                return
        except OSError:
            pass
        assert process is None or process.poll() is None, "it has ended"
        if time.monotonic() > deadline:
            raise TimeoutError(complaint() if callable(complaint) else complaint)
        time.sleep(0.02)
