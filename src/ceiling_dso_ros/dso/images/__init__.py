# SPDX-License-Identifier: BSD-3-Clause
"""Processing of one image: its pyramid, interpolation, and the selection of pixels for tracking."""
