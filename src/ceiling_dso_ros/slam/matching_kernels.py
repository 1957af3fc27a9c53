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
def vote(queries: np.ndarray, among: np.ndarray, first: np.ndarray, most_bits: int, tie_bits: int) -> np.ndarray:
    """Votes of descriptors for keyframes, (N,) float64.

    Each query has one vote, which all keyframes share whose nearest descriptor is about as near as the nearest of all.

    Args:
        queries: (K, 4) uint64.
        among: (M, 4) uint64 of all keyframes, one after the other.
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
            least = FAR
            for j in range(first[k], first[k + 1]):
                least = min(least, _distance(queries, i, among, j))
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
            agreeing = 0
            for k in range(count):
                dx = a[k, 0] - (c * b[k, 0] - s * b[k, 1] + x)
                dy = a[k, 1] - (s * b[k, 0] + c * b[k, 1] + y)
                agreeing += dx * dx + dy * dy < tolerance[k] * tolerance[k]
            result[found, 0], result[found, 1], result[found, 2], result[found, 3] = agreeing, x, y, yaw
            found += 1
    return result[:found]
