# SPDX-License-Identifier: BSD-3-Clause
"""How much memory this process holds."""

import ctypes
from pathlib import Path


def resident_mb() -> float:
    """Memory in use, MB, after free memory was returned to the system; free memory would hide a growth."""
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6
