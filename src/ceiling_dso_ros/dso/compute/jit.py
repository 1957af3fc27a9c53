# SPDX-License-Identifier: BSD-3-Clause
"""How every kernel of the odometry is compiled: one place for numba's options.

`kernel` compiles a function to machine code, caches it on disk and releases the GIL while it runs. Division follows
numpy (no exception on zero), without which LLVM cannot vectorise loops that divide. Sums may be reordered and
multiplications fused, but NaN and infinity keep their meaning.

`kernel_noalias` adds the promise that no array a kernel writes overlaps another argument, as C's `restrict`. Loops that
gather from one array and store to another vectorise only with it. numba has the flag but no public option; where a
version lacks it, the plain kernel is used, which is correct and slower.

`kernel_inlined` is for functions that are called per pixel: a loop with a call does not vectorise, and LLVM does not
inline longer functions by itself.
"""

import os
import stat
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Set, TypeVar, cast

import llvmlite.binding as llvm
import numba

Function = TypeVar("Function", bound=Callable[..., Any])

FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_compiled: List[Any] = []
_uncached: List[Path] = []  # folders of kernels for which numba has found no folder that it can write
_distrusted: List[Path] = []  # folders that numba has found, but that others can write
_OPTIONS: Dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": FASTMATH}


def _let_avx2_gather() -> None:
    """Tell LLVM that gathers are fast; else it reads pixels one by one on processors with AVX2 but without AVX-512."""
    features = numba.config.CPU_FEATURES or llvm.get_host_cpu_features().flatten()
    names = features.split(",")
    if "+avx2" in names and "+avx512f" not in names and not any("fast-gather" in name for name in names):
        numba.config.CPU_FEATURES = f"{features},+fast-gather"


def _noalias_option() -> Dict[str, Any]:
    try:
        from numba.core.cpu import CPUTargetOptions
        from numba.core.options import TargetOptions

        CPUTargetOptions.noalias = TargetOptions.Mapping("noalias")
        numba.njit(noalias=True)(lambda: None)
    except (ImportError, AttributeError, KeyError, TypeError):
        return {}
    return {"noalias": True}


def cache_folder(compiled: Callable[..., Any]) -> Optional[Path]:
    """Where the machine code of a kernel is cached; None where nothing can be cached."""
    path = compiled.stats.cache_path  # type: ignore[attr-defined]  # a function to its callers, numba's class in truth
    return None if path is None else Path(path)


def cache_problem() -> str:
    """Why kernels that have been imported are not cached, and what to do, in words; empty where all are."""
    every_time = "kernels are compiled at every start, which takes minutes"
    if _distrusted:
        return (
            f"{every_time}: {_distrusted[0]} is not used, because another user could have put machine code there; set "
            "NUMBA_CACHE_DIR to a folder of your own that only you can write"
        )
    if not _uncached:
        return ""
    asked_for = os.environ.get("NUMBA_CACHE_DIR")
    tried = [*filter(None, [asked_for]), f"{_uncached[0]}/__pycache__"]
    return (
        f"{every_time}: {', '.join(tried)} and the user's cache folder cannot be written; set NUMBA_CACHE_DIR to a "
        "folder that can"
    )


def cache_folders() -> Set[Path]:
    """Where the machine code of all kernels that have been imported is cached."""
    return {folder for folder in map(cache_folder, _compiled) if folder is not None}


def kernel(function: Function) -> Function:
    """Decorate a function that is compiled to machine code."""
    return _compile(function, _OPTIONS)


def kernel_inlined(function: Function) -> Function:
    """Decorate a function that is compiled into every kernel that calls it."""
    return _compile(function, _INLINED_OPTIONS)


def kernel_noalias(function: Function) -> Function:
    """Decorate a kernel no written array of which overlaps another argument."""
    return _compile(function, _NOALIAS_OPTIONS)


def _compile(function: Function, options: Dict[str, Any]) -> Function:
    compiled = _cached_where_possible(function, options)
    _compiled.append(compiled)
    # What is compiled is called as the function is, and checked as such.
    return cast(Function, compiled)


def _cached_where_possible(function: Function, options: Dict[str, Any]) -> Any:  # noqa: ANN401 numba has no types
    source = Path(function.__code__.co_filename)
    uncached = {**options, "cache": False}
    try:
        compiled = numba.njit(**options)(function)
    except RuntimeError:  # numba finds no folder that it can write
        _uncached.append(source.parent)
        return numba.njit(**uncached)(function)
    folder = cache_folder(compiled)
    if folder is None or is_trusted(folder, source):
        return compiled
    _distrusted.append(folder)
    return numba.njit(**uncached)(function)


def is_trusted(folder: Path, source: Path) -> bool:
    """Whether what is in a folder may be run: numba unpickles what it has cached there.

    It must belong to this user, to root, or to the owner of the source file, which is run anyway, and not everybody may
    write to it.
    """
    status = folder.stat()
    owners = {os.geteuid(), 0, source.stat().st_uid}
    return status.st_uid in owners and not status.st_mode & stat.S_IWOTH


_let_avx2_gather()
_INLINED_OPTIONS = {**_OPTIONS, "forceinline": True}
_NOALIAS_OPTIONS = {**_OPTIONS, **_noalias_option()}
