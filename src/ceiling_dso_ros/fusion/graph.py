# SPDX-License-Identifier: BSD-3-Clause
"""The factor graph: base poses and log-scales of the keyframes, connected by factors of wheels and camera.

`WindowGraph` keeps the newest keyframes for the live estimate; what leaves the window stays as a Gaussian prior on the
oldest that remain. `smoothing.py` solves the graph of a whole drive at once, from the same measurements.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, Deque, Dict, List, Optional, Sequence, Tuple

import gtsam
import numpy as np

from ceiling_dso_ros.dso.status import ScaleMeasurement
from ceiling_dso_ros.fusion import factors, planar
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.linear import LINEAR_SOLVER, joint_covariance
from ceiling_dso_ros.fusion.metre import fields_of, first_metre, metre_of, stereo_factor
from ceiling_dso_ros.fusion.motion import MOTION
from ceiling_dso_ros.fusion.smoothing import step_covariances
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_motion import ANY_TURN_SIGMA, WheelMotion, WheelNoise

ANCHOR_SIGMA = 1e-5  # metres and rad: odom is where the first wheel sample was taken
FIRST_HEIGHT_M = 4.0  # of a ceiling of unknown height, with a sigma of 1: 1.5 to 11 m
FIRST_HEIGHT_SIGMA = 1.0
MAX_ITERATIONS = 8  # of the live estimate, which begins close to its solution
COST_TOLERANCE = 1e-4  # half a squared sigma is 1
STANDING_SHIFT = 0.01  # units: lower bound of the distance for the scale's drift, for keyframes without translation


@dataclass(frozen=True)
class Interval:
    """Measurements between node `end` - 1 and node `end`. Node 0 is the anchor, the others are keyframes.

    Attributes:
        end: number of the later node.
        stamp_ns: its stamp.
        wheels: motion of the wheels.
        visual: motion of the camera; None when there is none, or none that can be used.
        continues: the scale of the end follows from that of the start: same segment, no jump.
        wheels_slip: the wheels contradict the camera, so their noise is increased, also where it is not used.
        doubt: (3,) standard deviations of the wheels' motion beyond that; None where there are none.
        depth: of the odometry's map as the end saw it, units; nan where it is not known.
        log_scale: guess of the logarithm of metres per unit, for the first of a segment; nan where there is none.
        stereo: the scale by a second camera; None where it does not tell it.
    """

    end: int
    stamp_ns: int
    wheels: WheelMotion
    visual: Optional[VisualMotion] = None
    continues: bool = False
    wheels_slip: bool = False
    doubt: Optional[np.ndarray] = None
    depth: float = math.nan
    log_scale: float = math.nan
    stereo: Optional[ScaleMeasurement] = None


@dataclass(frozen=True)
class GraphEstimate:
    """The graph's estimate at the newest keyframe.

    Attributes:
        stamp_ns: its stamp.
        pose: (3,) base in odom.
        covariance: (3, 3) of the pose, mean wheel radius taken as exact.
        log_scale: logarithm of metres per visual unit.
        scale_sigma: its standard deviation, mean wheel radius taken as exact.
        constants: (2,) logarithms of wheel ratio and wheel base relative to nominal.
        constants_covariance: (2, 2) of them.
        log_metre: logarithm of metres by the wheels per metre by a second camera; nan without one.
    """

    stamp_ns: int
    pose: np.ndarray
    covariance: np.ndarray
    log_scale: float
    scale_sigma: float
    constants: np.ndarray
    constants_covariance: np.ndarray
    log_metre: float = math.nan


class FactorBuilder:
    """Turns intervals into factors."""

    def __init__(self, config: FusionConfig, noise: WheelNoise) -> None:
        self._config = config
        self._noise = noise
        self._estimate_wheels = config.graph.estimate_wheels
        known = noise.constants_covariance(with_radius=False)
        self._unmodelled = np.zeros((3, 3)) if self._estimate_wheels else known
        self._huber = gtsam.noiseModel.mEstimator.Huber.Create(config.visual.robust_threshold)

    def first_factors(self) -> List[gtsam.NonlinearFactor]:
        """The one absolute anchor, and the priors of the constants if they are estimated."""
        anchor = gtsam.noiseModel.Isotropic.Sigma(3, ANCHOR_SIGMA)
        result = [gtsam.PriorFactorPose2(factors.pose_key(0), gtsam.Pose2(), anchor)]
        if self._estimate_wheels:
            wheels = self._config.wheels
            sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.array([wheels.ratio_sigma, wheels.base_sigma]))
            yaw = gtsam.noiseModel.Isotropic.Sigma(1, self._config.graph.camera_yaw_sigma_rad)
            result.append(gtsam.PriorFactorVector(factors.WHEEL_KEY, np.zeros(2), sigmas))
            result.append(gtsam.PriorFactorDouble(factors.CAMERA_YAW_KEY, 0.0, yaw))
        return result

    def first_values(self) -> gtsam.Values:
        """Values of the variables of `first_factors`."""
        values = gtsam.Values()
        values.insert(factors.pose_key(0), gtsam.Pose2())
        if self._estimate_wheels:
            values.insert_vector(factors.WHEEL_KEY, np.zeros(2))
            values.insert(factors.CAMERA_YAW_KEY, 0.0)
        return values

    def factors(self, interval: Interval) -> List[gtsam.NonlinearFactor]:
        """The factors of one interval: wheels always, camera where it saw the motion, scale."""
        i, j = factors.pose_key(interval.end - 1), factors.pose_key(interval.end)
        scale = factors.scale_key(interval.end)
        wheel_noise = gtsam.noiseModel.Gaussian.Covariance(self._wheel_covariance(interval))
        wheel_factor = factors.calibrated_wheel_factor if self._estimate_wheels else factors.wheel_factor
        result = [wheel_factor((i, j), interval.wheels, wheel_noise), self._scale_factor(interval)]
        if interval.stereo is not None:
            result.append(stereo_factor(scale, interval.stereo, self._config.visual.robust_threshold))
        if interval.visual is not None:
            noise = gtsam.noiseModel.Gaussian.Covariance(interval.visual.noise(self._config.visual))
            robust = gtsam.noiseModel.Robust.Create(self._huber, noise)
            result.append(factors.visual_factor((i, j, scale), interval.visual, robust, self._estimate_wheels))
        return result

    def motion(self, interval: Interval, start_pose: np.ndarray) -> np.ndarray:
        """The same as numbers: one MOTION, given the (3,) pose of its start."""
        motion = np.zeros((), MOTION)
        motion["end"], motion["stamp_ns"], motion["start_pose"] = interval.end, interval.stamp_ns, start_pose
        motion["wheels"], motion["by_constants"] = interval.wheels.pose, interval.wheels.jacobian[:, 1:]
        motion["wheels_covariance"] = self._wheel_covariance(interval)
        motion["continues"], motion["walk_sigma"] = interval.continues, self._walk_sigma(interval)
        motion["log_scale"] = self.first_log_scale(interval)
        motion["has_stereo"], motion["stereo"] = fields_of(interval.stereo)
        visual = interval.visual
        if visual is not None:
            motion["is_seen"], motion["shift"], motion["yaw"] = True, visual.shift, visual.yaw
            motion["lever_m"], motion["swing_m"] = visual.lever_m[:2], visual.lever_m[2] * visual.tilt
            motion["visual_covariance"] = visual.noise(self._config.visual)
        return motion

    @staticmethod
    def guess(interval: Interval) -> gtsam.Pose2:
        """Approximate motion of the base; the rotation is the camera's, which is more accurate and needs no scale."""
        forward, left, turn = interval.wheels.pose
        return gtsam.Pose2(forward, left, turn if interval.visual is None else interval.visual.yaw)

    def first_log_scale(self, interval: Interval) -> Tuple[float, float]:
        """Initial value for the scale of a new segment, and its sigma: one unit is about the depth of its first map."""
        height_m = self._config.scale.ceiling_height_m
        if height_m or math.isfinite(interval.log_scale):
            guess = interval.log_scale if math.isfinite(interval.log_scale) else math.log(height_m or FIRST_HEIGHT_M)
            return guess, self._config.scale.height_sigma
        return math.log(FIRST_HEIGHT_M), FIRST_HEIGHT_SIGMA

    def _scale_factor(self, interval: Interval) -> gtsam.NonlinearFactor:
        end = factors.scale_key(interval.end)
        if interval.continues:
            walk = gtsam.noiseModel.Isotropic.Sigma(1, self._walk_sigma(interval))
            return gtsam.BetweenFactorDouble(factors.scale_key(interval.end - 1), end, 0.0, walk)
        guess, sigma = self.first_log_scale(interval)
        return gtsam.PriorFactorDouble(end, guess, gtsam.noiseModel.Isotropic.Sigma(1, sigma))

    def _walk_sigma(self, interval: Interval) -> float:
        """Of the change of the log-scale over an interval."""
        way = STANDING_SHIFT if interval.visual is None else max(STANDING_SHIFT, np.hypot(*interval.visual.shift))
        return self._config.scale.walk_sigma * math.sqrt(way)

    def _wheel_covariance(self, interval: Interval) -> np.ndarray:
        covariance = self._noise.covariance(interval.wheels, self._unmodelled)
        if interval.wheels_slip:  # a slipping wheel may turn several times as far as the robot moves
            forward, left, turn = interval.wheels.pose
            reach = 3.0 * (math.hypot(forward, left) + 0.5 * self._noise.wheel_base_m * abs(turn)) + 0.05
            turn_sigma = min(2.0 * reach / self._noise.wheel_base_m, ANY_TURN_SIGMA)
            covariance = covariance + np.diag([reach, reach, turn_sigma]) ** 2
        if interval.doubt is not None:
            covariance = covariance + np.diag(interval.doubt) ** 2
        return covariance


class WindowGraph:
    """The live estimate over the newest keyframes; its cost does not grow with the distance driven.

    Attributes:
        history: what the intervals that have left the window have measured, MOTION in their order, for `smooth`; None
            unless they are to be kept. Who takes some out keeps them elsewhere.
    """

    def __init__(self, config: FusionConfig, noise: WheelNoise, keep_history: bool = False) -> None:
        self._config = config
        self._builder = FactorBuilder(config, noise)
        self._window = config.graph.window
        self._constants_covariance = noise.constants_covariance(with_radius=False)[1:, 1:]
        self._estimate_wheels = config.graph.estimate_wheels
        self._prior = self._builder.first_factors()
        self._values = self._builder.first_values()
        self._intervals: Deque[Interval] = deque()
        self._factors: Dict[int, List[gtsam.NonlinearFactor]] = {}
        self._parameters = gtsam.LevenbergMarquardtParams()
        self._parameters.setLinearSolverType(LINEAR_SOLVER)
        self._parameters.setMaxIterations(MAX_ITERATIONS)
        self._parameters.setRelativeErrorTol(COST_TOLERANCE)
        self._parameters.setAbsoluteErrorTol(COST_TOLERANCE)
        self.history: Optional[List[np.ndarray]] = [] if keep_history else None

    @property
    def intervals(self) -> Sequence[Interval]:
        """The intervals of the window, the oldest first."""
        return self._intervals

    def motions(self) -> List[np.ndarray]:
        """What the intervals of the window measure, each MOTION."""
        return [self._motion(interval) for interval in self._intervals]

    @property
    def oldest(self) -> int:
        """Number of the oldest node."""
        return self._intervals[0].end - 1 if self._intervals else 0

    def pose(self, node: int) -> np.ndarray:
        """(3,) estimate of a node of the window, relative to the first wheel sample."""
        pose = self._values.atPose2(factors.pose_key(node))
        return np.array([pose.x(), pose.y(), pose.theta()])

    def log_scale(self, node: int) -> float:
        """Estimate of the logarithm of metres per visual unit at a node of the window, not at the oldest one."""
        return float(self._values.atDouble(factors.scale_key(node)))

    def step_covariances(self, start: int, end: int) -> np.ndarray:
        """(end - start, 3, 3) of the motions between the nodes from one to another, both of the window."""
        intervals = [interval for interval in self._intervals if start < interval.end <= end]
        motions = np.array([self._motion(interval) for interval in intervals], MOTION)
        steps = [planar.between(self.pose(i.end - 1), self.pose(i.end)) for i in intervals]
        scales = [self.log_scale(interval.end) for interval in intervals]
        return step_covariances(motions, np.reshape(steps, (-1, 3)), np.array(scales), self._config)

    @property
    def newest(self) -> int:
        """Number of the newest node."""
        return self._intervals[-1].end if self._intervals else 0

    def add(self, interval: Interval) -> None:
        """Append the newest keyframe, and turn what leaves the window into a prior; on errors nothing changes.

        Raises:
            RuntimeError: of gtsam, such as for a covariance that is not positive.
        """
        values = gtsam.Values(self._values)
        pose = values.atPose2(factors.pose_key(interval.end - 1)).compose(self._builder.guess(interval))
        log_scale, _ = self._builder.first_log_scale(interval)
        if interval.continues:
            log_scale = values.atDouble(factors.scale_key(interval.end - 1))
        values.insert(factors.pose_key(interval.end), pose)
        values.insert(factors.scale_key(interval.end), log_scale)
        new_factors = self._builder.factors(interval)
        of_metre = first_metre(values, interval.stereo, self._config.wheels.radius_sigma)
        if len(self._intervals) == self._window:
            self._marginalise_oldest(values)
        self._values = values
        self._intervals.append(interval)
        self._factors[interval.end] = new_factors
        self._prior = self._prior + of_metre

    def revise(self, end: int, **changes: Any) -> None:  # noqa: ANN401 each attribute has its own type
        """Replace an interval; no effect if it has left the window."""
        oldest = self._intervals[0].end if self._intervals else end + 1
        if end < oldest:
            return
        interval = replace(self._intervals[end - oldest], **changes)
        self._intervals[end - oldest] = interval
        self._prior = self._prior + first_metre(self._values, interval.stereo, self._config.wheels.radius_sigma)
        self._factors[end] = self._builder.factors(interval)

    def optimize(self) -> GraphEstimate:
        """Estimate all variables of the window.

        If the newest camera motion is so wrong that there is no solution, only the wheels are used for it.
        """
        try:
            return self._solve()
        except (RuntimeError, np.linalg.LinAlgError):  # an indeterminate system, in gtsam and in numpy
            self.revise(self.newest, visual=None, stereo=None)
            return self._solve()

    def _solve(self) -> GraphEstimate:
        graph = gtsam.NonlinearFactorGraph()
        for factor in self._prior:
            graph.push_back(factor)
        for interval in self._intervals:
            for factor in self._factors[interval.end]:
                graph.push_back(factor)
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, self._values, self._parameters)
        values = optimizer.optimize()
        if not math.isfinite(optimizer.error()):
            raise RuntimeError("a motion is not finite")
        estimate = self._estimate(values, graph.linearize(values))
        self._values = values
        return estimate

    def _estimate(self, values: gtsam.Values, linear: gtsam.GaussianFactorGraph) -> GraphEstimate:
        pose_key, scale_key = factors.pose_key(self.newest), factors.scale_key(self.newest)
        pose = values.atPose2(pose_key)
        wheels = [factors.WHEEL_KEY] if self._estimate_wheels else []
        covariance = joint_covariance(linear, [pose_key, scale_key, *wheels], 4 + 2 * len(wheels))
        return GraphEstimate(
            self._intervals[-1].stamp_ns,
            np.array([pose.x(), pose.y(), pose.theta()]),
            covariance[:3, :3],
            values.atDouble(scale_key),
            math.sqrt(covariance[3, 3]),
            values.atVector(factors.WHEEL_KEY) if self._estimate_wheels else np.zeros(2),
            covariance[4:, 4:] if self._estimate_wheels else self._constants_covariance,
            metre_of(values),
        )

    def _marginalise_oldest(self, values: gtsam.Values) -> None:
        """Eliminate the oldest node from its factors and from the values; the prior is what remains on other nodes."""
        interval = self._intervals[0]
        touching = gtsam.NonlinearFactorGraph()
        for factor in self._prior + self._factors[interval.end]:
            touching.push_back(factor)
        oldest = [factors.pose_key(interval.end - 1), factors.scale_key(interval.end - 1)]
        oldest = [key for key in oldest if values.exists(key)]
        _, remaining = touching.linearize(values).eliminatePartialSequential(oldest)
        prior = [gtsam.LinearContainerFactor(remaining.at(index), values) for index in range(remaining.size())]
        left = None if self.history is None else self._motion(interval)
        for key in oldest:
            values.erase(key)
        self._prior = prior
        self._intervals.popleft()
        del self._factors[interval.end]
        if self.history is not None and left is not None:
            self.history.append(left)

    def _motion(self, interval: Interval) -> np.ndarray:
        start = self._values.atPose2(factors.pose_key(interval.end - 1))
        return self._builder.motion(interval, np.array([start.x(), start.y(), start.theta()]))
