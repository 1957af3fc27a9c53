"""How every kernel of the odometry is compiled: one place for numba's options.

`kernel` compiles a function to machine code, caches it on disk and releases the GIL while it runs. Division follows
numpy (no exception on zero), without which LLVM cannot vectorise loops that divide. Sums may be reordered and
multiplications fused, but NaN and infinity keep their meaning.

`kernel_noalias` adds the promise that no array a kernel writes overlaps another argument, as C's `restrict`. Loops that
gather from one array and store to another vectorise only with it. numba has the flag but no public option; where a
version lacks it, the plain kernel is used, which is correct and slower.
"""

from typing import Any, Callable, Dict

import numba

FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_OPTIONS: Dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": FASTMATH}


def _noalias_option() -> Dict[str, Any]:
    try:
        from numba.core.cpu import CPUTargetOptions
        from numba.core.options import TargetOptions

        CPUTargetOptions.noalias = TargetOptions.Mapping("noalias")
        numba.njit(noalias=True)(lambda: None)
    except (ImportError, AttributeError, KeyError, TypeError):
        return {}
    return {"noalias": True}


kernel: Callable[..., Any] = numba.njit(**_OPTIONS)
kernel_noalias: Callable[..., Any] = numba.njit(**_OPTIONS, **_noalias_option())
