# SPDX-License-Identifier: BSD-3-Clause
import os
import subprocess
import sys

import pytest

ALLOCATE = """
import ctypes, threading
from ceiling_dso_ros.ros.heap import use_one_heap
{call}
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
together = threading.Barrier(5)
def allocate():
    for _ in range(100):
        libc.malloc(10_000)
    together.wait()
threads = [threading.Thread(target=allocate) for _ in range(4)]
for thread in threads:
    thread.start()
together.wait()
libc.malloc_stats()
"""


def heaps(call, **variables):
    environment = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    script = ALLOCATE.format(call=call)
    run = subprocess.run(
        [sys.executable, "-c", script], env={**environment, **variables}, capture_output=True, text=True, check=True
    )
    return run.stderr.count("Arena ")


@pytest.mark.skipif(sys.platform != "linux", reason="a heap of glibc")
def test_threads_share_one_heap():
    assert heaps("pass") > 1
    assert heaps("use_one_heap()") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="a heap of glibc")
def test_who_sets_the_number_of_heaps_decides():
    assert heaps("use_one_heap()", MALLOC_ARENA_MAX="3") > 1
