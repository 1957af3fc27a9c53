# SPDX-License-Identifier: BSD-3-Clause
"""Wheel odometry, the factor graph that estimates the metric scale, and the filter for the published pose."""
