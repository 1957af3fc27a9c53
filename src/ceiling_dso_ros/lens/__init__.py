# SPDX-License-Identifier: BSD-3-Clause
"""The lens of a drive: finds intrinsics and distortion together with the camera's mount and the wheels' dimensions."""
