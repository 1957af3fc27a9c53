# SPDX-License-Identifier: BSD-3-Clause
"""Poses, motions and the camera's projection."""
