# SPDX-License-Identifier: BSD-3-Clause
"""Plays a recording's wheel samples into the fusion together with the odometry, as on a robot."""

from typing import Any, Callable, Dict, List, Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso import CameraMotion, ConfigError, OdometryStatus
from ceiling_dso_ros.fusion.config import FusionConfig, RobotModel
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.recording import Recording, RobotDescription, WheelSamples
from ceiling_dso_ros.io.stamps import LATEST_NS, format_stamp
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.io.warning_log import WarningLog, ignore_warning
from ceiling_dso_ros.playback.fused_record import FusedRecord, smoothed_trajectory
from ceiling_dso_ros.playback.wheel_check import uncovered, why_unusable
from ceiling_dso_ros.playback.wheel_playback import WheelPlayback


def robot_model(robot: RobotDescription) -> RobotModel:
    """Robot model of the fusion for a recorded robot.

    Raises:
        ConfigError: the camera does not look up, or a dimension is out of range.
    """
    return RobotModel(
        robot.T_base_camera,
        robot.wheel_base_m,
        robot.wheel_radius_m,
        robot.ticks_per_turn,
        camera_time_offset_s=robot.camera_time_offset_s,
    )


def usable_fusion(recording: Recording, config: FusionConfig, warnings: WarningLog) -> "Optional[FusionPlayback]":
    """The fusion of a run; None without usable wheels, which is warned of where there are some.

    Raises:
        InputError: the robot's dimensions cannot be used.
    """
    wheels = recording.wheels
    if wheels is None:
        return None
    problem = why_unusable(recording, wheels)
    if problem or recording.robot is None:
        warnings.add(f"{problem}; the wheels are not used")
        return None
    missing = uncovered(recording, wheels)
    if missing:
        warnings.add(missing)
    try:
        return FusionPlayback(wheels, robot_model(recording.robot), config, warnings.add)
    except ConfigError as error:
        raise InputError(f"{recording.path}: {error}") from error


OF_FUSION = ("wheel.tum", "fused.tum", "fused_smoothed.tum")  # files of a run with wheels


class FusionPlayback:
    """One run of the fusion over a recording.

    Every sample and every image is used at its stamp, as if the computation took no time. The fused trajectory contains
    what would have been published at that time, without later information.

    Attributes:
        estimator: the fusion.
    """

    def __init__(
        self,
        wheels: WheelSamples,
        robot: RobotModel,
        config: FusionConfig = FusionConfig(),
        warn: Callable[[str], None] = ignore_warning,
    ) -> None:
        """Begin; warn is told what is wrong with a wheel sample."""
        self.estimator = FusionEstimator(robot, config, keep_history=True)
        self._samples = wheels
        self._wheels = WheelPlayback(wheels, self.estimator, warn)
        self._record = FusedRecord()
        self._fused: List[FusedState] = []

    @classmethod
    def of(cls, recording: Recording, config: FusionConfig = FusionConfig()) -> "FusionPlayback":
        """Of a recording with wheels.

        Raises:
            InputError: it has no wheels, or the robot's dimensions are unknown.
            ConfigError: the camera does not look up, or a dimension is out of range.
        """
        if recording.wheels is None or recording.robot is None:
            raise InputError(f"{recording.path}: needs wheels and the robot's dimensions")
        return cls(recording.wheels, robot_model(recording.robot), config)

    def add(self, status: OdometryStatus) -> None:
        """Add the result of an image, after the wheel samples up to its stamp."""
        self._play_wheels(status.stamp_ns)
        self.estimator.add_keyframes(status)
        self.estimator.add_frame(status)

    def predicted_motion(self, last: OdometryStatus, stamp_ns: int) -> Optional[CameraMotion]:
        """Motion of the camera by the wheels to the next image; see `FusionEstimator.predict_camera_motion`."""
        self._play_wheels(stamp_ns)
        return self.estimator.predict_camera_motion(last, stamp_ns)

    def finish(self) -> None:
        """Add the wheel samples after the last image, and use all data that waited for them."""
        self._play_wheels()
        self.estimator.finish()

    def files(self) -> Dict[str, Callable[[], Trajectory]]:
        """Names of files -> what makes their trajectory: base_link in odom."""
        return dict(zip(OF_FUSION, (self.wheel, self.fused, self.smoothed)))

    @property
    def states(self) -> Sequence[FusedState]:
        """What would have been published, in order."""
        return self._fused

    def wheel(self) -> Trajectory:
        """The wheels alone, at every sample except the first."""
        return self._record.wheel()

    def smoothed(self) -> Trajectory:
        """The keyframes as the graph of the whole recording estimates them."""
        return smoothed_trajectory(self.estimator.smoothed())

    def fused(self) -> Trajectory:
        """What would have been published, at every wheel sample."""
        return self._record.fused()

    def summary(self) -> Dict[str, Any]:
        """The wheels, the last scale (None if never known), the slips, and the changes of state with their reasons."""
        scale = self.estimator.scale
        return {
            "wheels": {
                "source": self._samples.source,
                "unit": self._samples.unit.value,
                "samples": len(self._samples),
                "dropped": self.estimator.wheels.dropped,
            },
            "scale": {
                "value": scale.value if np.isfinite(scale.value) else None,
                "sigma": scale.sigma if np.isfinite(scale.sigma) else None,
                "converged": scale.converged,
            },
            "slips": [[format_stamp(report.start_ns), format_stamp(report.end_ns)] for report in self.estimator.slips],
            "fusion": self._changes(),
        }

    def _play_wheels(self, until_ns: int = LATEST_NS) -> None:
        for state in self._wheels.until(until_ns):
            self._fused.append(state)
            self._record.add(state, self.estimator.wheels.total.pose)

    def _changes(self) -> List[Dict[str, Any]]:
        changes: List[Dict[str, Any]] = []
        last = None
        for fused in self._fused:
            sources = (fused.state, tuple(reason.partition(":")[0] for reason in fused.reasons))
            if sources != last:
                changes.append(
                    {
                        "stamp": format_stamp(fused.stamp_ns),
                        "state": fused.state.value,
                        "reasons": list(fused.reasons),
                    }
                )
                last = sources
        return changes
