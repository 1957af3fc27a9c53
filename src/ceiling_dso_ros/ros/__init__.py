# SPDX-License-Identifier: BSD-3-Clause
"""ROS 1 messages to and from the core, one server class per node: the only place that imports rospy."""
