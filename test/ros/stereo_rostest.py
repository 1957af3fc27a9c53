#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""A second camera live: keyframes tell metres per unit, as the wheels do."""

import math
import sys
import time
import unittest

import rospy
import rostest

from ceiling_dso_ros.msg import FusionScale, Keyframes

TIMEOUT_S = 400.0
WANTED = 8  # keyframes that tell the scale
SIGMAS = 4.0
RADIUS_SIGMA = 0.005  # of the wheels, by the defaults of fusion_node


class Stereo(unittest.TestCase):
    def test_keyframes_tell_the_scale_that_wheels_find(self):
        told, scales = {}, []

        def hear(message):
            told.update({k.id: k for k in message.keyframes if k.log_scale_sigma > 0.0})

        rospy.Subscriber("visual_odometry/keyframes", Keyframes, hear, queue_size=100)
        rospy.Subscriber("fusion/scale", FusionScale, scales.append, queue_size=100)
        deadline = time.monotonic() + TIMEOUT_S
        while len(told) < WANTED or not any(scale.converged for scale in scales):
            self.assertLess(time.monotonic(), deadline, f"{len(told)} keyframes tell the scale, {len(scales)} scales")
            time.sleep(0.1)
        newest = told[max(told)]
        self.assertGreater(newest.log_scale_sigma, 0.0)
        self.assertGreater(newest.log_scale_common_sigma, 0.003)
        sigma = math.hypot(math.hypot(newest.log_scale_sigma, newest.log_scale_common_sigma), RADIUS_SIGMA)
        by_wheels = math.log(next(scale.scale for scale in reversed(scales) if scale.converged))
        self.assertAlmostEqual(newest.log_scale, by_wheels, delta=SIGMAS * sigma)


if __name__ == "__main__":
    rospy.init_node("stereo_rostest")
    rostest.rosrun("ceiling_dso_ros", "stereo", Stereo, sys.argv)
