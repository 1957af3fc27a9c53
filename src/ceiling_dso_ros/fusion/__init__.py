"""Wheel odometry, the factor graph that makes the visual odometry metric, and the filter that publishes it."""
