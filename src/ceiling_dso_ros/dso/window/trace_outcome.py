# SPDX-License-Identifier: BSD-3-Clause
"""Results of the last trace of a candidate point."""

UNTRACED = 0
GOOD = 1
SKIPPED = 2  # the interval is already so short that a search cannot shorten it
BAD_CONDITION = 3  # the search line runs along an edge: the position on it is not observable now
OUT_OF_BOUNDS = 4
OUTLIER = 5
DELETED = 6
