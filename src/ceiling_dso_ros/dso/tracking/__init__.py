"""Tracking: the pose of an image relative to the newest keyframe."""
