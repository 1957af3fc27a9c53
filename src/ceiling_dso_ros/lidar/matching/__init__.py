# SPDX-License-Identifier: BSD-3-Clause
"""Scans aligned with submaps: the first pass."""
