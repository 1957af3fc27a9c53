# SPDX-License-Identifier: BSD-3-Clause
"""What an interval of the graph measures, as a record of fixed size: for `smoothing.py`, and for files."""

import numpy as np

MOTION = np.dtype(
    [
        ("end", "<i8"),  # number of the later node; the earlier one has the number before
        ("stamp_ns", "<i8"),  # of the later node
        ("start_pose", "<f8", 3),  # live estimate of the earlier node, relative to the first wheel sample
        ("wheels", "<f8", 3),  # pose of the later node seen from the earlier one, by the wheels
        ("wheels_covariance", "<f8", (3, 3)),
        ("by_constants", "<f8", (3, 2)),  # derivative of `wheels` by (ln ratio, ln base)
        ("is_seen", "?"),  # whether the camera saw the motion; else the next five have no meaning
        ("shift", "<f8", 2),  # of the camera, VO units
        ("yaw", "<f8"),
        ("lever_m", "<f8", 2),  # position of the camera in the base
        ("swing_m", "<f8", 2),  # of the camera, by the tilt of the robot
        ("visual_covariance", "<f8", (3, 3)),  # of (shift, yaw), units and rad
        ("continues", "?"),  # the scale follows from that of the earlier node, else it is a new one
        ("walk_sigma", "<f8"),  # of the change of the log-scale from node to node
        ("has_stereo", "?"),  # whether a second camera measured the scale; else the next one has no meaning
        ("stereo", "<f8", 3),  # logarithm of metres per unit, standard deviations of its own and of the common error
        ("log_scale", "<f8", 2),  # prior of a new scale: mean and standard deviation of its logarithm
    ]
)
