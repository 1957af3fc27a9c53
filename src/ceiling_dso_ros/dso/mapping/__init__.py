"""Mapping: tracing of candidate points, and insertion of keyframes into the window."""
