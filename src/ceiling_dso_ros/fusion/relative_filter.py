# SPDX-License-Identifier: BSD-3-Clause
"""Kalman filter of the motion since the newest keyframe: wheels predict it, tracked images correct it."""

from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Sequence, Union

import numpy as np
from filterpy.kalman import KalmanFilter

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep

GATE = 30.0  # chi-square of three degrees of freedom: passed by all but one in a million


@dataclass(frozen=True)
class Sighting:
    """Pose of the base at an image relative to the keyframe, measured by the camera.

    Attributes:
        stamp_ns: of the image.
        pose: (3,) seen from the base at the keyframe, metres.
        covariance: (3, 3) of it.
    """

    stamp_ns: int
    pose: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class RelativeState:
    """Where the base is, seen from where it was at the keyframe.

    Attributes:
        stamp_ns: nanoseconds.
        pose: (3,).
        constants: (2,) logarithms of wheel ratio and wheel base relative to nominal.
        covariance: (5, 5) of pose and constants.
    """

    stamp_ns: int
    pose: np.ndarray
    constants: np.ndarray
    covariance: np.ndarray


@dataclass
class _Entry:
    event: Union[WheelStep, Sighting]
    after: RelativeState


class RelativeFilter:
    """An error-state filter. A late image is applied at its own stamp, and the wheel steps after it are replayed.

    The constants of the wheels are states: within a second without camera their error exceeds the white noise.

    Args:
        noise: of the wheels.
        stamp_ns: where it begins, before the first keyframe.
        constants_covariance: (2, 2) of the wheels' constants by then.
        history_s: how late an image may come.
    """

    def __init__(
        self, noise: WheelNoise, stamp_ns: int, constants_covariance: np.ndarray, history_s: float = 1.0
    ) -> None:
        self._noise = noise
        self._history_ns = nanoseconds(history_s)
        self._filter = KalmanFilter(dim_x=5, dim_z=3)
        self._filter.H = np.eye(3, 5)
        self._filter.inv = planar.inverse_3x3
        self._entries: Deque[_Entry] = deque()
        self.restart(stamp_ns, np.zeros(2), constants_covariance, [])

    @property
    def state(self) -> RelativeState:
        """The newest state."""
        return self._entries[-1].after if self._entries else self._root

    def restart(
        self,
        stamp_ns: int,
        constants: np.ndarray,
        constants_covariance: np.ndarray,
        events: Sequence[Union[WheelStep, Sighting]],
    ) -> None:
        """Begin at a keyframe and replay what came after it.

        Args:
            stamp_ns: of the keyframe.
            constants: (2,) of the wheels.
            constants_covariance: (2, 2) of them.
            events: wheel steps and sightings since, seen from this keyframe, in any order.
        """
        covariance = np.zeros((5, 5))
        covariance[:3, :3] = self._noise.resolution
        covariance[3:, 3:] = constants_covariance
        self._root = RelativeState(stamp_ns, np.zeros(3), np.array(constants), covariance)
        self._entries.clear()
        for event in events:
            if isinstance(event, WheelStep):
                self.predict(event)
        for event in events:
            if isinstance(event, Sighting):
                self.correct(event)

    def after(self, step: WheelStep) -> RelativeState:
        """The state after a step that begins where the last ended, which is not appended."""
        return self._predicted(self.state, step)

    def predict(self, step: WheelStep) -> None:
        """Append a wheel step that begins where the last ended."""
        self._entries.append(_Entry(step, self.after(step)))
        oldest_ns = step.end_ns - self._history_ns
        while self._entries[0].after.stamp_ns < oldest_ns:
            self._root = self._entries.popleft().after

    def correct(self, sighting: Sighting) -> bool:
        """Take in an image; False when it is older than what is remembered, or newer than the wheels."""
        if not self._root.stamp_ns <= sighting.stamp_ns <= self.state.stamp_ns:
            return False
        later: List[Union[WheelStep, Sighting]] = []
        while self._entries and self._entries[-1].after.stamp_ns > sighting.stamp_ns:
            later.append(self._entries.pop().event)
        step = later[-1] if later else None
        if isinstance(step, WheelStep):
            later.pop()
            before = step.clip(step.start_ns, sighting.stamp_ns)
            after = step.clip(sighting.stamp_ns, step.end_ns)
            later += [part for part in (after,) if part is not None]
            if before is not None:
                self._entries.append(_Entry(before, self._predicted(self.state, before)))
        self._entries.append(_Entry(sighting, self._corrected(self.state, sighting)))
        for event in reversed(later):
            self._entries.append(_Entry(event, self._with(event)))
        return True

    def _with(self, event: Union[WheelStep, Sighting]) -> RelativeState:
        if isinstance(event, WheelStep):
            return self._predicted(self.state, event)
        return self._corrected(self.state, event)

    def _predicted(self, state: RelativeState, step: WheelStep) -> RelativeState:
        by_constants = self._noise.sensitivity(step.twist)[:, 1:]
        twist = step.twist + by_constants @ state.constants
        J = planar.right_jacobian(twist)
        transition = np.eye(5)
        transition[:3, :3] = planar.adjoint(planar.expmap(-twist))
        transition[:3, 3:] = J @ by_constants
        process = np.zeros((5, 5))
        process[:3, :3] = J @ self._noise.white(step) @ J.T
        self._filter.x, self._filter.P = np.zeros((5, 1)), state.covariance
        self._filter.predict(F=transition, Q=process)
        pose = planar.compose(state.pose, planar.expmap(twist))
        return RelativeState(step.end_ns, pose, state.constants, self._filter.P)

    def _corrected(self, state: RelativeState, sighting: Sighting) -> RelativeState:
        """Kalman update of the error state; if the wheels contradict the image, their steps up to here are not used."""
        error = planar.between(state.pose, sighting.pose)
        covariance = state.covariance
        spread = covariance[:3, :3] + sighting.covariance
        if error @ planar.inverse_3x3(spread) @ error > GATE:
            covariance = covariance.copy()
            covariance[:3, :3] += np.diag(error**2)
        self._filter.x, self._filter.P = np.zeros((5, 1)), covariance
        self._filter.update(error.reshape(3, 1), R=sighting.covariance)
        change = self._filter.x.ravel()
        pose = planar.compose(state.pose, change[:3])
        return RelativeState(sighting.stamp_ns, pose, state.constants + change[3:], self._filter.P)
