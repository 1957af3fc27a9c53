# SPDX-License-Identifier: BSD-3-Clause
"""A study: many runs of the odometry over recordings, with all combinations of settings, kept in a folder."""
