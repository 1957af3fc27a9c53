# SPDX-License-Identifier: BSD-3-Clause
"""Cameras: a RealSense that streams in a process of its own. Alone imports pyrealsense2, and knows nothing of ROS."""
