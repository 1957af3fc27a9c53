"""Poses, motions and the camera's projection."""
