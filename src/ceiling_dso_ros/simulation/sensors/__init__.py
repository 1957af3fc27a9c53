# SPDX-License-Identifier: BSD-3-Clause
"""What the robot's sensors measure, except the cameras' images: wheel encoders, laser scanner, inertial unit."""
