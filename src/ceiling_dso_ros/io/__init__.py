# SPDX-License-Identifier: BSD-3-Clause
"""Recordings, calibration files and trajectories: everything that is read from or written to disk."""
