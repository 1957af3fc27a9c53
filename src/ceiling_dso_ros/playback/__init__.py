# SPDX-License-Identifier: BSD-3-Clause
"""One run over a recording: odometry, fusion, and their results."""
