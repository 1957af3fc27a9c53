# SPDX-License-Identifier: BSD-3-Clause
"""Nearest neighbours among the pixels of an image, by buckets."""

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel


@kernel
def nearest_neighbours(
    u: np.ndarray, v: np.ndarray, query_u: np.ndarray, query_v: np.ndarray, width: int, height: int, wanted: int
) -> np.ndarray:
    """Indices, (queries, wanted) int64, of the points nearest to each query.

    Buckets hold a few points on average; rings of buckets around a query are searched until enough points are found,
    then one ring more. A slot that stays empty, where there are fewer points than wanted, repeats the nearest one.
    """
    cell = max(1.0, np.sqrt(4.0 * width * height / max(u.size, 1)))
    columns, rows = int(width / cell) + 1, int(height / cell) + 1
    count = np.zeros(columns * rows + 1, np.int64)
    bucket = np.empty(u.size, np.int64)
    for i in range(u.size):
        bucket[i] = int(v[i] / cell) * columns + int(u[i] / cell)
        count[bucket[i] + 1] += 1
    first = np.cumsum(count)
    members = np.empty(u.size, np.int64)
    fill = first.copy()
    for i in range(u.size):
        members[fill[bucket[i]]] = i
        fill[bucket[i]] += 1
    result = np.empty((query_u.size, wanted), np.int64)
    distance = np.empty(wanted)
    for q in range(query_u.size):
        column, row = int(query_u[q] / cell), int(query_v[q] / cell)
        distance[:] = np.inf
        result[q, :] = -1
        last_ring = columns + rows
        ring = 0
        while ring <= last_ring:
            for y in range(max(0, row - ring), min(rows, row + ring + 1)):
                for x in range(max(0, column - ring), min(columns, column + ring + 1)):
                    if max(abs(x - column), abs(y - row)) != ring:
                        continue
                    for m in range(first[y * columns + x], first[y * columns + x + 1]):
                        i = members[m]
                        d = (u[i] - query_u[q]) ** 2 + (v[i] - query_v[q]) ** 2
                        if d < distance[wanted - 1]:
                            k = wanted - 1
                            while k > 0 and distance[k - 1] > d:
                                distance[k], result[q, k] = distance[k - 1], result[q, k - 1]
                                k -= 1
                            distance[k], result[q, k] = d, i
            if result[q, wanted - 1] >= 0 and last_ring > ring + 1:
                last_ring = ring + 1
            ring += 1
        for k in range(1, wanted):
            if result[q, k] < 0:
                result[q, k] = result[q, 0]
    return result
