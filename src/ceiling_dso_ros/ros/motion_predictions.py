# SPDX-License-Identifier: BSD-3-Clause
"""Predictions of the camera's motion since the last image, received from fusion_node."""

import bisect
from collections import deque
from dataclasses import replace
from typing import Deque, NamedTuple, Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.msg import MotionPrediction
from ceiling_dso_ros.ros.conversions import covariance_from_message, matrix_from_pose

LONGEST_STRETCH = 3.0  # a prediction may be extended to this multiple of its duration
REMEMBERED = 200  # messages: those of a second, of wheels that are read 200 times a second


class _Received(NamedTuple):
    """A message with its stamps in nanoseconds."""

    start_ns: int
    end_ns: int
    message: MotionPrediction


class MotionPredictions:
    """Uses the messages of `fusion/motion_prediction`.

    Each goes from the last image that the fusion has heard of to a wheel sample. Where images come all at once, later
    ones are asked for before it has heard of the one before; the messages of an earlier start tell that motion, too.

    Attributes:
        asked, used: number of images for which a prediction was wanted, and for which there was one.
    """

    def __init__(self) -> None:
        self._received: Deque[_Received] = deque(maxlen=REMEMBERED)
        self.asked = self.used = 0

    def add(self, message: MotionPrediction) -> None:
        """Store a message."""
        self._received.append(_Received(message.start.to_nsec(), message.header.stamp.to_nsec(), message))

    def between(self, start_ns: int, end_ns: int, segment: int) -> Optional[CameraMotion]:
        """Predicted motion of the camera between two image stamps of a segment; None without a prediction."""
        received = [each for each in list(self._received) if each.message.segment == segment]
        motion = _of_start(received, start_ns, end_ns)
        if motion is None:
            earlier_ns = max((each.start_ns for each in received if each.start_ns < start_ns), default=None)
            motion = None if earlier_ns is None else _from_earlier(received, earlier_ns, start_ns, end_ns)
        self.asked += 1
        self.used += motion is not None
        return motion


def _of_start(received: Sequence[_Received], start_ns: int, end_ns: int) -> Optional[CameraMotion]:
    """By the messages of that start: between the ends of two of them, or beyond the first or the last."""
    of_start = sorted((each for each in received if each.start_ns == start_ns), key=lambda each: each.end_ns)
    if not of_start:
        return None
    later = bisect.bisect([each.end_ns for each in of_start], end_ns)
    if later in (0, len(of_start)):
        return stretched(of_start[min(later, len(of_start) - 1)].message, end_ns)
    (_, before_ns, before), (_, after_ns, after) = of_start[later - 1], of_start[later]
    first, second = stretched(before, before_ns), stretched(after, after_ns)
    if first is None or second is None:
        return None
    share = (end_ns - before_ns) / (after_ns - before_ns)
    step = se3.log(se3.inverse(first.T_start_end) @ second.T_start_end)
    return replace(second, T_start_end=first.T_start_end @ se3.exp(share * step))


def _from_earlier(received: Sequence[_Received], earlier_ns: int, start_ns: int, end_ns: int) -> Optional[CameraMotion]:
    """By the motions from an earlier start to both; it is at most as uncertain as the longer one."""
    to_start, to_end = (_of_start(received, earlier_ns, stamp_ns) for stamp_ns in (start_ns, end_ns))
    if to_start is None or to_end is None or to_start.metric != to_end.metric:
        return None
    T_start_earlier = se3.inverse(to_start.T_start_end)
    move = se3.adjoint(T_start_earlier)
    return replace(
        to_end, T_start_end=T_start_earlier @ to_end.T_start_end, covariance=move @ to_end.covariance @ move.T
    )


def stretched(message: MotionPrediction, end_ns: int) -> Optional[CameraMotion]:
    """The predicted motion extended to another end with constant velocity.

    Its standard deviation grows in proportion. None if the values are not valid or the end is too far away.
    """
    start_ns = message.start.to_nsec()
    predicted_ns, wanted_ns = message.header.stamp.to_nsec() - start_ns, end_ns - start_ns
    if predicted_ns <= 0 or not 0 < wanted_ns <= LONGEST_STRETCH * predicted_ns:
        return None
    try:
        T_start_predicted = matrix_from_pose(message.motion)
        covariance = covariance_from_message(message.covariance)
    except ValueError:
        return None
    stretch = wanted_ns / predicted_ns
    T_start_end = se3.exp(stretch * se3.log(T_start_predicted))
    return CameraMotion(T_start_end, stretch**2 * covariance, bool(message.metric), unit_vector(message.normal))


def unit_vector(vector: Sequence[float]) -> Optional[np.ndarray]:
    """(3,) float64 in a vector's direction; None where it has none."""
    values = np.array(vector, dtype=float)
    length = np.linalg.norm(values)
    return values / length if 0.0 < length < np.inf else None
