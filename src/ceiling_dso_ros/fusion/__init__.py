"""Wheel odometry, the factor graph that estimates the metric scale, and the filter for the published pose."""
