# SPDX-License-Identifier: BSD-3-Clause
"""Small dense symmetric positive definite systems, solved inside kernels.

LAPACK's rounding depends on the number of threads, also for systems as small as these. Poses must not depend on it.
"""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel


@kernel
def solve_positive(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve H x = b by Cholesky factorisation after scaling the diagonal to one.

    Directions in which H has no information (pivot not positive) get a zero step instead of an error.

    Args:
        H: (n, n) float64, symmetric; only the lower triangle is read.
        b: (n,) float64.
    """
    n = b.size
    scale = np.empty(n)
    for i in range(n):
        scale[i] = 1.0 / math.sqrt(H[i, i]) if H[i, i] > 1e-30 else 0.0
    L = np.zeros((n, n))
    x = np.empty(n)
    for i in range(n):
        for j in range(i + 1):
            total = H[i, j] * scale[i] * scale[j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = math.sqrt(total) if total > 1e-12 else 0.0
            elif L[j, j] > 0.0:
                L[i, j] = total / L[j, j]
    for i in range(n):
        total = b[i] * scale[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i] if L[i, i] > 0.0 else 0.0
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i] if L[i, i] > 0.0 else 0.0
    return x * scale


@kernel
def invert_positive(H: np.ndarray) -> np.ndarray:
    """Inverse of H, (n, n) float64, symmetric positive semi-definite; zero in directions without information."""
    inverse, unit = np.empty_like(H), np.zeros(H.shape[0])
    for i in range(unit.size):
        unit[i] = 1.0
        inverse[:, i] = solve_positive(H, unit)
        unit[i] = 0.0
    return inverse
