# SPDX-License-Identifier: BSD-3-Clause
"""A path of straight parts and arcs, and a small pure-pursuit follower that knows nothing but odometry."""

import numpy as np

from ceiling_dso_ros.fusion import planar

STEP_M = 0.01
LOOKAHEAD_M = 0.4
SPEED_M_S = 0.6
BRAKING_M_S2 = 0.3  # half of what the base can do, so that it follows


def path(*parts):
    """Points (N, 2) from the origin along x; each part is a length in metres and the angle in degrees that it turns."""
    headings = [np.zeros(1)]
    for length_m, turn_deg in parts:
        count = round(length_m / STEP_M)
        headings.append(headings[-1][-1] + np.radians(turn_deg) * np.arange(1, count + 1) / count)
    yaw = np.concatenate(headings)
    middle = (yaw[1:] + yaw[:-1]) / 2
    steps = STEP_M * np.stack([np.cos(middle), np.sin(middle)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def distance_m(points, xy):
    """Distance of a position from a path that goes on straight at its end."""
    onward = points[-1] + np.arange(1, 100)[:, None] * (points[-1] - points[-2])
    line = np.concatenate([points, onward])
    along = line[1:] - line[:-1]
    share = np.clip(((xy - line[:-1]) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(xy - line[:-1] - share[:, None] * along, axis=1).min())


class PathFollower:
    """Steers along a path.

    Args:
        points: (N, 2) of the path.
        start: x, y, yaw of its origin.

    Attributes:
        driven_m: how far along the path the robot is.
    """

    def __init__(self, points, start):
        self.points, self.start = points, start
        self.driven_m = 0.0

    @property
    def left_m(self):
        """What is left of the path."""
        return STEP_M * (len(self.points) - 1) - self.driven_m

    def has_passed(self, place_m):
        """Whether the robot is further along the path."""
        return self.driven_m > place_m

    def command(self, pose):
        """Speed and yaw rate at a pose x, y, yaw; zeros at the end of the path."""
        x, y, yaw = planar.between(self.start, pose)
        here = round(self.driven_m / STEP_M)
        ahead = self.points[here : here + 100]
        self.driven_m = STEP_M * (here + int(np.linalg.norm(ahead - (x, y), axis=1).argmin()))
        if self.left_m < STEP_M / 2:
            return 0.0, 0.0
        speed = min(SPEED_M_S, np.sqrt(2 * BRAKING_M_S2 * self.left_m) + 0.02)
        beyond = self.driven_m + LOOKAHEAD_M - STEP_M * (len(self.points) - 1)
        target = self.points[min(round((self.driven_m + LOOKAHEAD_M) / STEP_M), len(self.points) - 1)]
        target = target + max(beyond, 0.0) / STEP_M * (self.points[-1] - self.points[-2])
        c, s = np.cos(yaw), np.sin(yaw)
        forward, left = c * (target[0] - x) + s * (target[1] - y), c * (target[1] - y) - s * (target[0] - x)
        return speed, speed * 2 * left / (forward**2 + left**2)
