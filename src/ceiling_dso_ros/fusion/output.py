# SPDX-License-Identifier: BSD-3-Clause
"""The published pose and twist: continuous, at the wheels' rate, converging to the best estimate.

The best estimate is the graph's newest keyframe and the motion since (`RelativeFilter`). The graph has used all
measurements up to that keyframe, so at the keyframe its estimate replaces the filter's. Combining the two as if they
were independent would not add information and would make the covariance too small.
"""

import math
from dataclasses import dataclass, replace
from typing import Sequence, Tuple, Union

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import OutputConfig
from ceiling_dso_ros.fusion.graph import GraphEstimate
from ceiling_dso_ros.fusion.relative_filter import RelativeFilter, RelativeState, Sighting
from ceiling_dso_ros.fusion.twist_filter import MeanTwist, TwistFilter
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep


@dataclass(frozen=True)
class Estimate:
    """A pose of the base in odom with its (3, 3) covariance."""

    pose: np.ndarray
    covariance: np.ndarray


class BlendedPose:
    """Follows the motion of the best estimate at once and its corrections gradually.

    A correction is the change of the best estimate beyond the motion. It is applied with a time constant and with a
    largest speed, so that the pose stays continuous, as REP-105 requires for `odom`.

    Attributes:
        config: of the output; may be changed between two of them.
        pose: (3,) last published.
    """

    def __init__(self, config: OutputConfig, pose: np.ndarray) -> None:
        self.config = config
        self.pose = np.array(pose)

    def follow(self, motion: np.ndarray, dt: float, target: Estimate) -> Estimate:
        """Move on by one output.

        Args:
            motion: (3,) of the base since the last output.
            dt: seconds since the last output.
            target: the best estimate now.

        Returns:
            The pose to publish; its covariance includes the remaining distance to the target.
        """
        config = self.config
        self.move(motion)
        missing = planar.between(self.pose, target.pose)
        step = (1.0 - math.exp(-dt / config.blend_s)) * missing
        length = math.hypot(step[0], step[1])
        longest, widest = config.max_correction_m_s * dt, config.max_correction_rad_s * dt
        if length > longest:
            step[:2] *= longest / length
        step[2] = max(-widest, min(widest, step[2]))
        self.pose = planar.compose(self.pose, step)
        return self.towards(target)

    def move(self, motion: np.ndarray) -> None:
        """Move on by (3,) of the base, without a correction."""
        self.pose = planar.compose(self.pose, motion)

    def towards(self, target: Estimate) -> Estimate:
        """The last pose; its covariance includes the distance to the best estimate."""
        missing = planar.between(self.pose, target.pose)
        return Estimate(self.pose, target.covariance + np.outer(missing, missing))


class LiveOutput:
    """Pose and twist now, from the newest keyframe on.

    Args:
        config: of the output.
        noise: error model of the wheels.
        stamp_ns: of the first wheel sample, which is where the pose is zero.
    """

    def __init__(self, config: OutputConfig, noise: WheelNoise, stamp_ns: int) -> None:
        self._noise = noise
        self._keyframe = Estimate(np.zeros(3), np.zeros((3, 3)))
        self._relative = RelativeFilter(noise, stamp_ns, noise.constants_covariance(with_radius=False)[1:, 1:])
        self._blended = BlendedPose(config, np.zeros(3))
        self._twist = TwistFilter(config, noise)

    @property
    def pose(self) -> np.ndarray:
        """(3,) last published."""
        return self._blended.pose

    @property
    def twist(self) -> np.ndarray:
        """(2,) m/s and rad/s now."""
        return self._twist.twist

    def configure(self, config: OutputConfig) -> None:
        """Let other settings count from the next output on; the pose goes on from the last one."""
        self._blended.config = config
        self._twist.configure(config)

    def restart(self, estimate: GraphEstimate, events: Sequence[Union[WheelStep, Sighting]]) -> None:
        """Continue from the graph's newest keyframe; events are the wheel steps and sightings after it."""
        self._keyframe = Estimate(estimate.pose, estimate.covariance)
        self._relative.restart(estimate.stamp_ns, estimate.constants, estimate.constants_covariance, events)

    def predict(self, step: WheelStep, slipping: bool, seen: bool) -> WheelStep:
        """Add the newest wheel step.

        Args:
            step: as measured.
            slipping: the camera contradicts the wheels now.
            seen: the camera will soon show the motion of this step. Then a change of speed that no robot is capable of
                waits for it, and so does a step that is not known.

        Returns:
            The step to use: a prediction if the sample is not usable.
        """
        self._twist.advance(step.end_ns)
        usable = step.known and not slipping and self._twist.add_step(step)
        if slipping or (seen and not usable):  # the robot is assumed to keep its velocity; images correct that
            forward, turn = step.duration_s * self.twist
            step = replace(step, twist=np.array([forward, 0.0, turn]), known=False)
        self._relative.predict(step)
        return step

    def correct(self, sighting: Sighting) -> None:
        """Take in a tracked image."""
        self._relative.correct(sighting)

    def correct_twist(self, seen: MeanTwist) -> None:
        """Take in the mean forward speed and yaw rate that the camera saw between two images."""
        self._twist.add_rate(seen.start_ns, seen.end_ns, seen.rate, seen.covariance)

    def withdraw_wheel_twist(self, since_ns: int) -> None:
        """Undo what the wheels have said of the twist since a stamp, nanoseconds: they slipped."""
        self._twist.withdraw_steps(since_ns)

    def publish(self, step: WheelStep) -> Tuple[Estimate, np.ndarray, np.ndarray]:
        """The output after a believed step: pose in odom with covariance, (2,) twist and its (2, 2) covariance."""
        blended = self._blended.follow(planar.expmap(step.twist), step.duration_s, self._best(self._relative.state))
        return self._published(blended), self.twist, self._twist.covariance

    def hold(self, step: WheelStep, goes_on: bool) -> Tuple[Estimate, np.ndarray, np.ndarray]:
        """The output after a time over which nothing tells of a motion; as `publish`, and no estimate changes.

        Args:
            step: a guess, over all of that time.
            goes_on: the last output was of the same time and has this motion.
        """
        if not goes_on:
            self._blended.move(planar.expmap(step.twist))
        held = self._blended.towards(self._best(self._relative.after(step)))
        return self._published(held), self.twist, self._twist.covariance_after(step.duration_s)

    def _best(self, relative: RelativeState) -> Estimate:
        """The best estimate, given the motion since the keyframe."""
        back = planar.adjoint(planar.inverse(relative.pose))
        return Estimate(
            planar.compose(self._keyframe.pose, relative.pose),
            back @ self._keyframe.covariance @ back.T + relative.covariance[:3, :3],
        )

    def _published(self, blended: Estimate) -> Estimate:
        """In odom, where a wrong mean radius scales the whole path."""
        covariance = planar.rotate_covariance(blended.covariance, blended.pose[2])
        position = blended.pose[:2]
        covariance[:2, :2] += self._noise.config.radius_sigma**2 * np.outer(position, position)
        return Estimate(blended.pose, covariance)


def either(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(3, 3) to add to the covariance of a (3,) pose, seen from odom, that is this one or the other."""
    missing = np.array([*(other[:2] - pose[:2]), planar.wrap(other[2] - pose[2])])
    return np.outer(missing, missing)
