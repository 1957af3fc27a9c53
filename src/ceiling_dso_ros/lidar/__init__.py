# SPDX-License-Identifier: BSD-3-Clause
"""A reference trajectory from a 2D LiDAR, where nobody has motion capture."""
