# SPDX-License-Identifier: BSD-3-Clause
"""Kernels that are compiled once, by a process of their own, and loaded by all others.

A process that compiles may round differently from those that load. A file beside the cached kernels says that they are
complete. Its name has a digest of all sources and of everything else that affects the machine code, because numba only
checks the file of a kernel and not those of the functions that it calls.
"""

import hashlib
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Callable, Optional, Sequence, Set

import llvmlite.binding as llvm
import numba

from ceiling_dso_ros.dso.compute.jit import cache_folder, cache_problem

PARENT = "CEILING_DSO_COMPILES_FOR"  # environment variable: pid of the process that waits for the kernels
PARENT_PERIOD_S = 0.5


def python_tag() -> str:
    """Of the files that numba writes for this Python."""
    return f"py{sys.version_info.major}{sys.version_info.minor}"


def complete_marker(kernel: Callable[..., object], sources: Sequence[Path], name: str) -> Optional[Path]:
    """The file that says that the cache is complete; None where nothing can be cached.

    Args:
        kernel: one of the kernels, beside whose machine code the file is.
        sources: folders of all that the kernels are made of.
        name: of the file, without its endings.
    """
    folder = cache_folder(kernel)
    if folder is None:
        return None
    digest = hashlib.sha256()
    for path in (path for folder in sources for path in sorted(folder.rglob("*.py"))):
        digest.update(path.read_bytes())
    features = numba.config.CPU_FEATURES or llvm.get_host_cpu_features().flatten()
    for text in (sys.version, numba.__version__, llvm.get_host_cpu_name(), features):
        digest.update(text.encode())
    return folder / f"{name}.{python_tag()}.{digest.hexdigest()[:16]}"


def compile_if_missing(marker: Optional[Path], module: str, tell: Callable[[str], None]) -> None:
    """Have a process compile all kernels, unless they are complete.

    Args:
        marker: says that they are.
        module: is run to compile them.
        tell: is called with a message before that, because it takes a minute or two, and where nothing can be cached.
    """
    if cache_problem():
        tell(cache_problem())
    if marker is not None and not marker.exists():
        tell("compiling the kernels, which takes a minute or two the first time")
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            PARENT: str(os.getpid()),
        }
        subprocess.run([sys.executable, "-m", module], env=environment, stdout=subprocess.DEVNULL, check=False)


def fill_cache(marker: Optional[Path], folders: Set[Path], warm_up: Callable[[], bool]) -> int:
    """Compile all kernels by running them, and note that they are complete.

    Args:
        marker: where that is noted; None where nothing can be cached.
        folders: from which outdated machine code is removed before.
        warm_up: runs them; False if it did not get to all of them.

    Returns:
        Exit code of the command that does only this.
    """
    start_s = time.perf_counter()
    if PARENT in os.environ:
        Thread(target=_end_with_parent, args=(int(os.environ[PARENT]),), daemon=True).start()
    if marker is not None and not marker.exists():
        remove_outdated(folders, marker.name.partition(".")[0])
    if not warm_up():
        print("error: the warm-up went wrong, some kernels are not compiled", file=sys.stderr)
        return 1
    if marker is not None:
        with suppress(OSError):
            marker.touch()
    print(f"kernels compiled and cached: ready in {time.perf_counter() - start_s:.1f} s")
    return 0


def _end_with_parent(parent_pid: int) -> None:
    """Nobody waits for the kernels any more, and who starts again compiles the rest."""
    while os.getppid() == parent_pid:
        time.sleep(PARENT_PERIOD_S)
    os._exit(1)


def remove_outdated(folders: Set[Path], name: str) -> None:
    """Remove machine code of this Python from folders, and the files of that name that said it was complete."""
    for folder in folders:
        with suppress(OSError):  # not ours, or there is none yet
            for pattern in (f"*.{python_tag()}.nbi", f"*.{python_tag()}.*.nbc", f"{name}.{python_tag()}.*"):
                for path in folder.glob(pattern):
                    path.unlink()
