# SPDX-License-Identifier: BSD-3-Clause
"""Linear algebra of the graph: how its systems are solved, and covariances of its variables."""

from typing import Sequence

import gtsam
import numpy as np

# Eliminates one variable at a time. In a block of several variables, gtsam treats one as undetermined if it is a few
# thousand times less certain than the others. The scale of a new segment is, while no measurement determines it.
LINEAR_SOLVER = "SEQUENTIAL_CHOLESKY"


def joint_covariance(linear: gtsam.GaussianFactorGraph, keys: Sequence[int], size: int) -> np.ndarray:
    """Covariance of some variables of a graph in their order, (size, size) float64, `size` their dimensions together.

    Not by `gtsam.Marginals`, which leaves no choice of `LINEAR_SOLVER`; the window is small enough for a dense matrix.

    Raises:
        numpy.linalg.LinAlgError: the graph does not determine all of its variables.
    """
    ordering = gtsam.Ordering()
    for key in [*(key for key in linear.keyVector() if key not in keys), *keys]:
        ordering.push_back(key)
    information, _ = linear.hessian(ordering)
    root = np.linalg.inv(np.linalg.cholesky(information)[-size:, -size:])
    return root.T @ root
