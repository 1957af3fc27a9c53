# SPDX-License-Identifier: BSD-3-Clause
"""What the wheels say of the motion between two stamps, and how sure that is."""

from typing import Callable, List, Optional

import numpy as np

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.io.recording import RobotDescription, WheelSamples, WheelUnit
from ceiling_dso_ros.lidar.scans.poses import Path, between, compose, expmap, logmap
from ceiling_dso_ros.playback.wheel_playback import wheel_steps

UP = np.eye(4)  # a camera that looks up, which the model of a robot needs and nothing here uses
USUAL_BASE_M = 0.5  # where the odometry is the robot's own
GAP_S = 0.5  # between two samples: over a longer one, the way of the wheels is unknown
LEAST_SIGMA_M, LEAST_SIGMA_RAD = 1e-3, 5e-4  # of any motion


class WheelMotions:
    """Dead reckoning over a whole recording.

    Attributes:
        path: of base_link, from where the wheels begin.
    """

    def __init__(self, path: Path, wheel_base_m: float, config: WheelConfig, known: np.ndarray) -> None:
        """Of poses at all samples; known (N - 1,) says which of the steps between them can be used."""
        self.path = path
        self._config, self._base_m = config, wheel_base_m
        arcs = logmap(between(path.poses[:-1], path.poses[1:]))
        self._way_m = np.append(0.0, np.cumsum(np.hypot(arcs[:, 0], arcs[:, 1])))
        self._turned_rad = np.append(0.0, np.cumsum(np.abs(arcs[:, 2])))
        self._broken = np.append(0, np.cumsum(~known))

    def covers(self, start_ns: np.ndarray, end_ns: np.ndarray) -> np.ndarray:
        """Whether the motions between (N,) pairs of stamps, in any order, are known, (N,) bool."""
        start_ns, end_ns = np.minimum(start_ns, end_ns), np.maximum(start_ns, end_ns)
        stamps_ns = self.path.stamps_ns
        inside = (start_ns >= stamps_ns[0]) & (end_ns <= stamps_ns[-1])
        first = np.clip(np.searchsorted(stamps_ns, start_ns, side="right") - 1, 0, None)
        last = np.clip(np.searchsorted(stamps_ns, end_ns), None, len(stamps_ns) - 1)
        return inside & (self._broken[last] == self._broken[first])

    def between(self, start_ns: np.ndarray, end_ns: np.ndarray) -> np.ndarray:
        """Poses of the base at (N,) stamps seen from those at others, (N, 3)."""
        return between(self.path.at(start_ns), self.path.at(end_ns))

    def sigmas(self, start_ns: np.ndarray, end_ns: np.ndarray) -> np.ndarray:
        """Standard deviations of ahead, left and turn over the motions between (N,) pairs of stamps, (N, 3)."""
        stamps_ns, config, base_m = self.path.stamps_ns, self._config, self._base_m
        way_m, turned_rad = (
            np.abs(np.interp(end_ns, stamps_ns, total) - np.interp(start_ns, stamps_ns, total))
            for total in (self._way_m, self._turned_rad)
        )
        white_m = config.noise_m_per_sqrt_m * np.sqrt(way_m + 0.5 * base_m * turned_rad)
        least_m, least_rad = np.full(len(way_m), LEAST_SIGMA_M), np.full(len(way_m), LEAST_SIGMA_RAD)
        base_rad, ratio_rad = config.base_sigma * turned_rad, config.ratio_sigma * way_m / base_m
        turn_rad = np.linalg.norm([least_rad, np.sqrt(2.0) * white_m / base_m, base_rad, ratio_rad], axis=0)
        ahead_m = np.linalg.norm([least_m, white_m, config.radius_sigma * way_m], axis=0)
        left_m = np.linalg.norm([least_m, 0.5 * white_m, 0.5 * way_m * turn_rad], axis=0)
        return np.stack([ahead_m, left_m, turn_rad], axis=1)


def wheel_motions(
    wheels: WheelSamples, robot: Optional[RobotDescription], warn: Callable[[str], None]
) -> Optional[WheelMotions]:
    """Dead reckoning from recorded wheels; None where they cannot be used, which is said.

    Args:
        wheels: the samples.
        robot: its dimensions, which poses do not need.
        warn: is told why the wheels are not used.
    """
    if robot is None and wheels.unit is not WheelUnit.POSES:
        warn(
            f"{wheels.source}: the wheels are not used, because the robot's dimensions are unknown: give them with "
            "--robot robot.yaml, or use its own odometry with --wheel-odometry /odom"
        )
        return None
    config = WheelConfig()
    try:
        model = (
            RobotModel(UP, USUAL_BASE_M)
            if robot is None
            else RobotModel(UP, robot.wheel_base_m, robot.wheel_radius_m, robot.ticks_per_turn)
        )
    except ConfigError as error:
        warn(f"{wheels.source}: the wheels are not used: {error}")
        return None
    if len(wheels) < 2:
        warn(f"{wheels.source}: the wheels are not used: there is only one sample")
        return None
    if wheels.unit is WheelUnit.POSES:  # as they are: logs have samples that are far apart
        path = Path(wheels.stamps_ns, np.asarray(wheels.readings, np.float64))
        return WheelMotions(path, model.wheel_base_m, config, np.ones(len(wheels) - 1, bool))
    steps = list(wheel_steps(wheels, WheelOdometry(model, config)))
    poses: List[np.ndarray] = [np.zeros(3)]
    for arc in expmap(np.array([step.twist for step in steps])):
        poses.append(compose(poses[-1], arc))
    stamps_ns = np.array([steps[0].start_ns, *(step.end_ns for step in steps)], np.int64)
    known = np.array([step.known and step.duration_s < GAP_S for step in steps])
    return WheelMotions(Path(stamps_ns, np.array(poses)), model.wheel_base_m, config, known)
