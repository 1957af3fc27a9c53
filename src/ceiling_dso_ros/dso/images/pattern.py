# SPDX-License-Identifier: BSD-3-Clause
"""The residual pattern: eight pixels that share the inverse depth of their centre."""

import numpy as np

PATTERN_X = np.array([0, -1, 1, -2, 0, 2, -1, 0], dtype=np.float32)
PATTERN_Y = np.array([-2, -1, -1, 0, 0, 0, 1, 2], dtype=np.float32)
PATTERN_SIZE = 8

GRADIENT_WEIGHT = np.float32(50.0 * 50.0)  # c^2 of the weight c^2 / (c^2 + |grad I|^2), equation (4)
HUBER = np.float32(9.0)  # grey levels
