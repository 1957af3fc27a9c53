# SPDX-License-Identifier: BSD-3-Clause
"""Where the robot drives: along a planned path, or as it is commanded."""
