# SPDX-License-Identifier: BSD-3-Clause
"""Tracking: the pose of an image relative to the newest keyframe."""
