# SPDX-License-Identifier: BSD-3-Clause
"""The heap of a node that runs for weeks."""

import ctypes
import os
from contextlib import suppress

M_ARENA_MAX = -8  # of mallopt(3)


def use_one_heap() -> None:
    """Have all threads that begin from now on share one heap of glibc.

    Otherwise each thread has its own, and each of these keeps the most that its thread ever needed at once: with the
    twenty threads of a node, the memory creeps up for hours. Python's lock lets one of them allocate at a time anyway.
    Who has set MALLOC_ARENA_MAX decides for himself; other C libraries have no such heaps.
    """
    if "MALLOC_ARENA_MAX" not in os.environ:
        with suppress(AttributeError):
            ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
