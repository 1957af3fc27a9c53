# SPDX-License-Identifier: BSD-3-Clause
"""Comparison of descriptors by Hamming distance, and the rigid motion in the plane that most matches agree with.

Descriptors are (K, 4) uint64. Points are (M, 3) float32 in their upright frames, metres.
"""

import math

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel, kernel_inlined

FAR = 257  # more than any distance
ONES = np.uint64(0x5555555555555555)
TWOS = np.uint64(0x3333333333333333)
FOURS = np.uint64(0x0F0F0F0F0F0F0F0F)
BYTES = np.uint64(0x0101010101010101)


@kernel_inlined
def _bits(x: np.uint64) -> np.uint64:
    x = x - ((x >> np.uint64(1)) & ONES)
    x = (x & TWOS) + ((x >> np.uint64(2)) & TWOS)
    x = (x + (x >> np.uint64(4))) & FOURS
    return (x * BYTES) >> np.uint64(56)


@kernel_inlined
def _distance(a: np.ndarray, i: int, b: np.ndarray, j: int) -> int:
    return int(
        _bits(a[i, 0] ^ b[j, 0]) + _bits(a[i, 1] ^ b[j, 1]) + _bits(a[i, 2] ^ b[j, 2]) + _bits(a[i, 3] ^ b[j, 3])
    )


@kernel
def self_similar(descriptors: np.ndarray, pixels: np.ndarray, most_bits: int, beside_px: float) -> np.ndarray:
    """(K,) bool: another corner of the image, not just beside, (K, 2) float64 pixels, has a similar descriptor."""
    count = descriptors.shape[0]
    similar = np.zeros(count, np.bool_)
    for i in range(count):
        for j in range(i):
            apart = (pixels[i, 0] - pixels[j, 0]) ** 2 + (pixels[i, 1] - pixels[j, 1]) ** 2
            if apart > beside_px**2 and _distance(descriptors, i, descriptors, j) <= most_bits:
                similar[i] = similar[j] = True
    return similar


@kernel
def nearest_depths(
    pixels: np.ndarray, u: np.ndarray, v: np.ndarray, depth: np.ndarray, count: int, reach_px: float
) -> np.ndarray:
    """Depths of the points nearest to corners, (K, count) float64, in any order; nan where fewer are within reach.

    Args:
        pixels: (K, 2) float64 of the corners.
        u, v, depth: (N,) float64 of the points.
        count: of points for each corner.
        reach_px: points further away tell nothing.
    """
    result = np.full((pixels.shape[0], count), np.nan)
    apart = np.empty(count)
    for k in range(pixels.shape[0]):
        apart[:] = reach_px**2
        farthest = 0
        for i in range(u.shape[0]):
            distance = (pixels[k, 0] - u[i]) ** 2 + (pixels[k, 1] - v[i]) ** 2
            if distance < apart[farthest]:
                apart[farthest], result[k, farthest] = distance, depth[i]
                farthest = int(np.argmax(apart))
    return result


@kernel
def nearest(queries: np.ndarray, among: np.ndarray) -> np.ndarray:
    """(K, 3) int64 of each query: index of the nearest, its distance, and the distance of the second nearest."""
    result = np.empty((queries.shape[0], 3), np.int64)
    for i in range(queries.shape[0]):
        best, first, second = -1, FAR, FAR
        for j in range(among.shape[0]):
            bits = _distance(queries, i, among, j)
            if bits < first:
                best, first, second = j, bits, first
            elif bits < second:
                second = bits
        result[i, 0], result[i, 1], result[i, 2] = best, first, second
    return result


@kernel
def _least_distance(query: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> int:
    """From one descriptor to many, given by word: this loop vectorises."""
    least = np.uint64(FAR)
    for j in range(a.shape[0]):
        least = min(
            least, _bits(query[0] ^ a[j]) + _bits(query[1] ^ b[j]) + _bits(query[2] ^ c[j]) + _bits(query[3] ^ d[j])
        )
    return int(least)


@kernel
def vote(queries: np.ndarray, among: np.ndarray, first: np.ndarray, most_bits: int, tie_bits: int) -> np.ndarray:
    """Votes of descriptors for keyframes, (N,) float64.

    Each query has one vote, which all keyframes share whose nearest descriptor is about as near as the nearest of all.

    Args:
        queries: (K, 4) uint64.
        among: (4, M) uint64, the words of the descriptors of all keyframes, one after the other.
        first: (N + 1,) int64, where those of each keyframe begin.
        most_bits: a nearest descriptor further away has no vote.
        tie_bits: how much further than the nearest still shares.
    """
    count = first.shape[0] - 1
    votes = np.zeros(count)
    of_keyframe = np.empty(count, np.int64)
    for i in range(queries.shape[0]):
        best = FAR
        for k in range(count):
            own = slice(first[k], first[k + 1])
            least = _least_distance(queries[i], among[0, own], among[1, own], among[2, own], among[3, own])
            of_keyframe[k] = least
            best = min(best, least)
        if best > most_bits:
            continue
        sharing = 0
        for k in range(count):
            sharing += of_keyframe[k] <= best + tie_bits
        for k in range(count):
            if of_keyframe[k] <= best + tie_bits:
                votes[k] += 1.0 / sharing
    return votes


@kernel
def _agreeing(
    a_x: np.ndarray, a_y: np.ndarray, b_x: np.ndarray, b_y: np.ndarray, squares: np.ndarray,
    c: float, s: float, x: float, y: float,
) -> int:  # fmt: skip
    """How many matches agree with a motion of that cosine, sine and shift: this loop vectorises."""
    count = 0
    for k in range(a_x.shape[0]):
        dx = a_x[k] - (c * b_x[k] - s * b_y[k] + x)
        dy = a_y[k] - (s * b_x[k] + c * b_y[k] + y)
        count += 1 if dx * dx + dy * dy < squares[k] else 0
    return count


@kernel
def motions_of_pairs(a: np.ndarray, b: np.ndarray, tolerance: np.ndarray, shortest_m: float) -> np.ndarray:
    """The motion T_a_b that each two matches give, and with how many matches it agrees.

    Args:
        a, b: (M, 3) float32 matched points.
        tolerance: (M,) float32 metres, within which a match agrees.
        shortest_m: two matches must be so far apart.

    Returns:
        (P, 4) float64: agreeing matches, x, y, yaw.
    """
    count = a.shape[0]
    a_x, a_y = a[:, 0].astype(np.float64), a[:, 1].astype(np.float64)
    b_x, b_y = b[:, 0].astype(np.float64), b[:, 1].astype(np.float64)
    squares = tolerance.astype(np.float64) ** 2
    result = np.empty((count * (count - 1) // 2, 4))
    found = 0
    for i in range(count):
        for j in range(i):
            ax, ay, bx, by = a[i, 0] - a[j, 0], a[i, 1] - a[j, 1], b[i, 0] - b[j, 0], b[i, 1] - b[j, 1]
            length_a, length_b = math.hypot(ax, ay), math.hypot(bx, by)
            if min(length_a, length_b) < shortest_m or abs(length_a - length_b) > tolerance[i] + tolerance[j]:
                continue
            yaw = math.atan2(ay, ax) - math.atan2(by, bx)
            c, s = math.cos(yaw), math.sin(yaw)
            mx, my = 0.5 * (b[i, 0] + b[j, 0]), 0.5 * (b[i, 1] + b[j, 1])
            x = 0.5 * (a[i, 0] + a[j, 0]) - (c * mx - s * my)
            y = 0.5 * (a[i, 1] + a[j, 1]) - (s * mx + c * my)
            agreeing = _agreeing(a_x, a_y, b_x, b_y, squares, c, s, x, y)
            result[found, 0], result[found, 1], result[found, 2], result[found, 3] = agreeing, x, y, yaw
            found += 1
    return result[:found]
