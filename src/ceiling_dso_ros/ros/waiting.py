# SPDX-License-Identifier: BSD-3-Clause
"""Waiting for a limited time, whatever happens to the machine's clock.

Before Python 3.11 a lock, a condition or an event that is waited for with a timeout waits until a time of the realtime
clock. When that clock is set back by an hour, it waits an hour longer. Sleeping goes by the monotonic clock.
"""

import time
from typing import Callable

STEP_S = 0.001


def wait_until(is_so: Callable[[], bool], timeout_s: float) -> bool:
    """Wait until something is so, or until timeout_s seconds are over; returns whether it is so."""
    end_s = time.monotonic() + timeout_s
    while not is_so():
        if time.monotonic() >= end_s:
            return False
        time.sleep(STEP_S)
    return True
