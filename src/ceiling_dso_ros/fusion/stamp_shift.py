# SPDX-License-Identifier: BSD-3-Clause
"""By how much the stamps of images are late or early, found from when camera and wheels begin and end to turn."""

import math
from collections import deque
from statistics import median
from typing import Deque, List, Optional

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

LONGEST_S = 0.3  # a clock that was set by more is found by when messages arrive
STEP_S = 0.01  # of the search
WINDOW_S = 3.0  # long enough for the begin or the end of a turn, too short for the wheels' slip to change much
STRIDE_S = 1.0  # to the next window
WORTH_S = 0.03  # a robot at 1 m/s and 1 rad/s is 3 cm and 30 mrad from where it is said to be
LONGEST_STEP_S = 2.0 * WORTH_S  # of the wheels: when they begin to turn is known to half a step
SIGMA_S = 0.005  # of a judgment: one in which the rate of turn changes too little is none
AGREEING = 3  # judgments of different turns
NOISE_RAD = 1e-3  # of a turn, at least: encoders, vibration of the mount
CORRELATED_S = 0.2  # the wheels' errors last so long
EXPLAINED = 0.99  # share of the camera's turn that the wheels, shifted, must explain
LARGEST_RATIO = 1.25  # of the two turns, by slip and a wheel base that is wrong


class StampShift:
    """Compares turns over windows of time; several of them in a row must agree before the stamps are blamed.

    Within a window the camera's turn is that of the wheels a little earlier, times a ratio: C(t) = k W(t - late) + c.
    Only a change of the rate of turn tells `late` from k and c, so that who drives straight on learns nothing.
    """

    def __init__(self) -> None:
        self._judgments_s: Deque[float] = deque(maxlen=AGREEING)
        self._stamps_ns: List[int] = []
        self._turns_rad: List[float] = []  # of the camera, up to each of the stamps

    def add(self, start_ns: int, end_ns: int, turn_rad: float, track: WheelTrack) -> None:
        """Take in the camera's turn between two images.

        Args:
            start_ns, end_ns: their stamps on the wheels' clock.
            turn_rad: about the floor's normal.
            track: of the wheels.
        """
        wheels = track.newest
        if not wheels.known or wheels.duration_s > LONGEST_STEP_S:
            self._stamps_ns = []
            return
        if not self._stamps_ns or self._stamps_ns[-1] != start_ns:
            self._stamps_ns, self._turns_rad = [start_ns], [0.0]
        self._stamps_ns.append(end_ns)
        self._turns_rad.append(self._turns_rad[-1] + turn_rad)
        known_ns = track.end_ns - nanoseconds(LONGEST_S)
        if seconds(known_ns - self._stamps_ns[0]) >= WINDOW_S:
            self._judge(sum(stamp_ns <= known_ns for stamp_ns in self._stamps_ns), track)

    @property
    def late_s(self) -> float:
        """Seconds by which stamps are after their images; 0 while nothing speaks against them."""
        judgments_s = self._judgments_s
        if len(judgments_s) < AGREEING or max(judgments_s) - min(judgments_s) > WORTH_S:
            return 0.0
        late_s = median(judgments_s)
        return late_s if abs(late_s) > WORTH_S else 0.0

    def other_pose(self, pose: np.ndarray, twist: np.ndarray) -> Optional[np.ndarray]:
        """Where a robot would be if images were right about its (3,) pose, but at another time; None unless they are.

        Args:
            pose: in odom.
            twist: (2,) forward speed and yaw rate.
        """
        late_s = self.late_s
        return planar.compose(pose, planar.expmap(late_s * np.array([twist[0], 0.0, twist[1]]))) if late_s else None

    def _judge(self, count: int, track: WheelTrack) -> None:
        """Judge the first images. No turn is in two judgments, but windows that tell nothing overlap."""
        stamps_ns, turns_rad = np.array(self._stamps_ns[:count]), np.array(self._turns_rad[:count])
        late_s = None
        if stamps_ns[0] - nanoseconds(LONGEST_S) >= track.start_ns:
            late_s = shift_of_turns(stamps_ns, turns_rad, track)
        used = int(np.searchsorted(stamps_ns, stamps_ns[0] + nanoseconds(STRIDE_S)))
        if late_s is not None:
            self._judgments_s.append(late_s)
            used = count - 1
        del self._stamps_ns[:used], self._turns_rad[:used]


def shift_of_turns(stamps_ns: np.ndarray, turns_rad: np.ndarray, track: WheelTrack) -> Optional[float]:
    """Seconds by which the camera turns later than the wheels; None where the turns do not tell.

    Args:
        stamps_ns: (N,) int64 of images.
        turns_rad: (N,) of the camera, up to each of them.
        track: of the wheels, from `LONGEST_S` before to `LONGEST_S` after.
    """
    shifts_s = STEP_S * np.arange(-round(LONGEST_S / STEP_S), round(LONGEST_S / STEP_S) + 1)
    by_wheels = track.turned(stamps_ns - np.rint(1e9 * shifts_s).astype(np.int64)[:, None])
    by_wheels -= by_wheels.mean(axis=1, keepdims=True)
    seen = turns_rad - turns_rad.mean()
    power = np.maximum((by_wheels**2).sum(axis=1), NOISE_RAD**2)
    ratios = by_wheels @ seen / power
    misfits = seen @ seen - ratios**2 * power
    best = int(misfits.argmin())
    if not 0 < best < len(shifts_s) - 1 or not 1.0 / LARGEST_RATIO < ratios[best] < LARGEST_RATIO:
        return None
    if misfits[best] > (1.0 - EXPLAINED) * (seen @ seen):
        return None
    by_shift = ratios[best] * (by_wheels[best + 1] - by_wheels[best - 1]) / (2.0 * STEP_S)
    by_shift -= by_wheels[best] * (by_wheels[best] @ by_shift) / power[best]
    of_one = max(CORRELATED_S * len(seen) / seconds(int(stamps_ns[-1] - stamps_ns[0])), 1.0)  # images that err alike
    noise_rad = max(NOISE_RAD, math.sqrt(max(misfits[best], 0.0) / len(seen)))
    if noise_rad * math.sqrt(of_one) > SIGMA_S * math.sqrt(by_shift @ by_shift):
        return None
    before, here, after = misfits[best - 1 : best + 2]
    return float(shifts_s[best] + 0.5 * STEP_S * (before - after) / (before - 2.0 * here + after))
