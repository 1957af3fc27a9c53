# SPDX-License-Identifier: BSD-3-Clause
"""A unit of time for comparing frame times between machines.

The unit is the time of a fixed workload on one thread: interpolating an image and its gradient, and normal equations of
a 2x2 system. Direct methods spend most of their time with such work. A time divided by this unit, measured right before
and after, hardly depends on the machine. The workload is compiled with numba's defaults on purpose: faster ways to
write it would change the unit.
"""

import time

import numba
import numpy as np

SAMPLES = 200_000
WIDTH, HEIGHT = 848, 480


@numba.njit(fastmath=True, cache=True)  # type: ignore[misc]  # numba has no types
def _workload(image: np.ndarray, grad_x: np.ndarray, grad_y: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.float32:
    h00 = h01 = h11 = b0 = b1 = np.float32(0)
    for k in range(xs.size):
        x, y = xs[k], ys[k]
        column, row = int(x), int(y)
        dx, dy = x - column, y - row
        w11 = dx * dy
        w10 = dy - w11
        w01 = dx - w11
        w00 = np.float32(1) - dx - dy + w11
        total = (
            w00 * image[row, column] + w01 * image[row, column + 1]
            + w10 * image[row + 1, column] + w11 * image[row + 1, column + 1]
        )  # fmt: skip
        gx = (
            w00 * grad_x[row, column] + w01 * grad_x[row, column + 1]
            + w10 * grad_x[row + 1, column] + w11 * grad_x[row + 1, column + 1]
        )  # fmt: skip
        gy = (
            w00 * grad_y[row, column] + w01 * grad_y[row, column + 1]
            + w10 * grad_y[row + 1, column] + w11 * grad_y[row + 1, column + 1]
        )  # fmt: skip
        residual = total - np.float32(100)
        weight = np.float32(1) if abs(residual) < 9 else np.float32(9) / abs(residual)
        h00 += weight * gx * gx
        h01 += weight * gx * gy
        h11 += weight * gy * gy
        b0 += weight * gx * residual
        b1 += weight * gy * residual
    return h00 + h01 + h11 + b0 + b1


def machine_ms(runs: int = 30) -> float:
    """Milliseconds of the workload: the least of several runs. The first call in a process may compile."""
    random = np.random.default_rng(0)
    images = [random.uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32) for _ in range(3)]
    xs = random.uniform(1, WIDTH - 3, SAMPLES).astype(np.float32)
    ys = random.uniform(1, HEIGHT - 3, SAMPLES).astype(np.float32)
    _workload(*images, xs, ys)
    least_s = float("inf")
    for _ in range(runs):
        start = time.perf_counter()
        _workload(*images, xs, ys)
        least_s = min(least_s, time.perf_counter() - start)
    return 1e3 * least_s
