# SPDX-License-Identifier: BSD-3-Clause
"""Scans as points, planar poses, and what the wheels say."""
