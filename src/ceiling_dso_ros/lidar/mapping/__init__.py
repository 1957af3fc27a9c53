# SPDX-License-Identifier: BSD-3-Clause
"""Loops, and poses and map solved together."""
