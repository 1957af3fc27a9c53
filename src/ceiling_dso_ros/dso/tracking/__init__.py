"""The pose of an image against the newest keyframe."""
