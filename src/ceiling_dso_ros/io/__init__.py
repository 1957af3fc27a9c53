"""Recordings, calibration files and trajectories: everything that is read from or written to disk."""
