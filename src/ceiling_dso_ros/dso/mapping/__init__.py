# SPDX-License-Identifier: BSD-3-Clause
"""Mapping: tracing of candidate points, and insertion of keyframes into the window."""
