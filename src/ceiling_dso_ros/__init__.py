"""Ceiling visual odometry for indoor industrial robots: Direct Sparse Odometry and wheel fusion."""

__version__ = "0.1.0"
