# SPDX-License-Identifier: BSD-3-Clause
"""What the points of the window tell of the vignetting.

A point that wanders through the image gets darker towards the corner. With V = exp(c . phi), phi = (rho^2, rho^4), a
pixel of the target is I_t = V_t (gain I_h / V_h + offset), which is linear in small c:

    I_t = gain I_h + offset + c . (predicted phi_t - gain I_h phi_h).

Gain and offset of the two images were found without c, so each pair finds them again: they are eliminated. So is a
shift of every point's pattern in the target, along the image gradient: the geometry has moved the points, at edges, to
where they look as bright as in the host.
"""

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel
from ceiling_dso_ros.dso.geometry.projection import in_view, warp_of, warp_point
from ceiling_dso_ros.dso.images.interpolation import sample_gradient
from ceiling_dso_ros.dso.images.pattern import GRADIENT_WEIGHT, HUBER, PATTERN_SIZE, PATTERN_X, PATTERN_Y

SHIFTS = 2  # columns before the others: x, y of the point's pattern in the target
COLUMNS = 5  # gain, offset, c1, c2, residual
ALL = SHIFTS + COLUMNS
LEAST_GRADIENT2 = 1.0  # sum over the pattern, so that a direction without gradient stays solvable
HALF = np.float32(0.5)


@kernel
def multiply_rows(rows: np.ndarray, products: np.ndarray) -> None:
    """Products of the rows (7, 8) with each other, upper triangle of (7, 7)."""
    for a in range(ALL):
        for b in range(a, ALL):
            total = np.float32(0.0)
            for p in range(PATTERN_SIZE):
                total += rows[a, p] * rows[b, p]
            products[a, b] = total


@kernel
def eliminate_shifts(products: np.ndarray) -> None:
    """Schur complement of the first two rows, in the upper triangle of (7, 7)."""
    for shift in range(SHIFTS):
        pivot = products[shift, shift] + LEAST_GRADIENT2
        for a in range(shift + 1, ALL):
            factor = products[shift, a] / pivot
            for b in range(a, ALL):
                products[a, b] -= factor * products[shift, b]


@kernel
def add_pixels(
    image: np.ndarray, width: int, height: int, centre: np.ndarray, radius2: float, KRKi: np.ndarray, Kt: np.ndarray,
    gain: np.float32, offset: np.float32, chosen: np.ndarray, u: np.ndarray, v: np.ndarray, idepth: np.ndarray,
    grey: np.ndarray, weight_host: np.ndarray, total: np.ndarray,
) -> int:  # fmt: skip
    """Add the pixels of one host's points in one target to the normal equations of (gain, offset, c1, c2).

    Args:
        image, width, height: level 0 of the target.
        centre, radius2: (2,) principal point and the squared pixels at which rho is 1.
        KRKi, Kt, gain, offset: of the pair.
        chosen: (n,) which points are used.
        u, v, idepth, grey, weight_host: (n,), grey and weight (8, n), of the host's points.
        total: (5, 5) float64, sums of the products of the columns and of the residual.

    Returns:
        How many pixels were used.
    """
    warp = warp_of(KRKi, Kt)
    rows, products = np.zeros((ALL, PATTERN_SIZE), np.float32), np.zeros((ALL, ALL))
    count = 0
    for i in range(u.size):
        if not chosen[i]:
            continue
        for p in range(PATTERN_SIZE):
            x_host, y_host = u[i] + PATTERN_X[p], v[i] + PATTERN_Y[p]
            x, y, z, _ = warp_point(warp, x_host, y_host, idepth[i])
            if not in_view(x, y, z, width, height):
                rows[:, p] = 0.0
                continue
            value, gx, gy = sample_gradient(image, width, np.float32(x), np.float32(y))
            scaled = gain * grey[p, i]
            predicted = scaled + offset
            residual = value - predicted
            weight = HALF * (weight_host[p, i] + np.sqrt(GRADIENT_WEIGHT / (GRADIENT_WEIGHT + gx * gx + gy * gy)))
            root = weight * np.sqrt(HUBER / max(abs(residual), HUBER))
            host2 = ((x_host - centre[0]) ** 2 + (y_host - centre[1]) ** 2) / radius2
            target2 = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / radius2
            rows[0, p], rows[1, p], rows[2, p], rows[3, p] = root * gx, root * gy, root * scaled, root
            rows[4, p] = root * (predicted * target2 - scaled * host2)
            rows[5, p] = root * (predicted * target2 * target2 - scaled * host2 * host2)
            rows[6, p] = root * residual
            count += 1
        multiply_rows(rows, products)
        eliminate_shifts(products)
        for a in range(COLUMNS):
            for b in range(a, COLUMNS):
                total[a, b] += products[SHIFTS + a, SHIFTS + b]
                total[b, a] = total[a, b]
    return count
