# SPDX-License-Identifier: BSD-3-Clause
"""The way from keyframe to keyframe by the odometry; keyframes that have hardly moved are left out."""

import itertools
from typing import NamedTuple, Optional

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import carried, walked
from ceiling_dso_ros.slam.records import KeyframeRecord

LEAST_STEP_M = 0.3
LEAST_TURN_RAD = 0.3
FEWEST_CORNERS = 10
FEWEST_POINTS = 100


class Step(NamedTuple):
    """A keyframe and the motion to it.

    Attributes:
        number: of the keyframe, counted over all steps.
        record: the keyframe.
        motion: (3,) of base_link from the step before, by the odometry; zero for the first.
        covariance: (3, 3) of it.
        way_m: driven from the first one to it.
    """

    number: int
    record: KeyframeRecord
    motion: np.ndarray
    covariance: np.ndarray
    way_m: float


class Way:
    """The keyframes of one session."""

    def __init__(self) -> None:
        self._count = itertools.count()
        self._last: Optional[Step] = None
        self._covariance = np.zeros((3, 3))
        self._before: Optional[np.ndarray] = None  # pose of the record before, also of one that was left out

    def add(self, record: KeyframeRecord) -> Optional[Step]:
        """The next step; None for a keyframe that is left out."""
        if self._before is not None:
            motion = planar.between(self._before, record.pose)
            self._covariance = carried(self._covariance, motion, record.step_covariance + walked(motion))
        self._before = record.pose
        motion = np.zeros(3) if self._last is None else planar.between(self._last.record.pose, record.pose)
        if len(record.corners.descriptor) < FEWEST_CORNERS or len(record.points) < FEWEST_POINTS:
            return None
        step_m = float(np.hypot(*motion[:2]))
        if self._last is not None and step_m < LEAST_STEP_M and abs(motion[2]) < LEAST_TURN_RAD:
            return None
        way_m = 0.0
        if self._last is not None:  # one that left the odometry's window late is a step back
            way_m = self._last.way_m + (step_m if record.stamp_ns >= self._last.record.stamp_ns else -step_m)
        step = Step(next(self._count), record, motion, self._covariance, way_m)
        self._last, self._covariance = step, np.zeros((3, 3))
        return step
