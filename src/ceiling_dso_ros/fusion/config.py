# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the fusion, frozen dataclasses with working defaults, one per part; and the robot's geometry."""

from dataclasses import dataclass, field
from typing import Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import require


def require_ranges(part: str, settings: object, **ranges: Tuple[float, float]) -> None:
    """Raise ConfigError unless every named attribute lies within its (smallest, largest)."""
    for name, (smallest, largest) in ranges.items():
        value = getattr(settings, name)
        require(smallest <= value <= largest, f"{part}.{name}={value}: {smallest:g} to {largest:g}")


@dataclass(frozen=True)
class RobotModel:
    """Geometry of a differential-drive robot with a camera that looks up.

    Attributes:
        T_base_camera: (4, 4) pose of the camera's optical frame in base_link, which is on the floor midway between the
            wheels.
        wheel_base_m: distance of the wheels' contact points.
        wheel_radius_m: (left, right); not needed when the wheels come as nav_msgs/Odometry.
        ticks_per_turn: encoder counts of one turn of a wheel; needed for ticks alone.
        reversed_wheels: (left, right), True where the encoder counts down when the robot drives ahead.
        camera_time_offset_s: what to add to an image's stamp to have it on the wheels' clock.

    Raises:
        ConfigError: a value is out of range, or the camera does not look up.
    """

    T_base_camera: np.ndarray
    wheel_base_m: float
    wheel_radius_m: Tuple[float, float] = (0.1, 0.1)
    ticks_per_turn: float = 4096.0
    reversed_wheels: Tuple[bool, bool] = (False, False)
    camera_time_offset_s: float = 0.0

    def __post_init__(self) -> None:
        T = np.asarray(self.T_base_camera, dtype=float)
        rigid = T.shape == (4, 4) and np.isfinite(T).all() and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0])
        rigid = rigid and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3) and np.linalg.det(T[:3, :3]) > 0
        require(rigid, "robot.T_base_camera: not a rigid motion")
        require(T[2, 2] > 0.5, "robot.T_base_camera: the camera must look up, its z axis along base_link's z")
        require(all(0.005 <= radius <= 5.0 for radius in self.wheel_radius_m), "robot.wheel_radius_m: 0.005 to 5")
        require_ranges(
            "robot", self, wheel_base_m=(0.01, 20.0), ticks_per_turn=(1.0, 1e9), camera_time_offset_s=(-1.0, 1.0)
        )


@dataclass(frozen=True)
class WheelConfig:
    """Error model of the wheels.

    The white part is per wheel and grows with the square root of the distance; the systematic parts are standard
    deviations of constants, so that their effect grows with the distance itself.
    """

    noise_m_per_sqrt_m: float = 0.005
    radius_sigma: float = 0.005  # mean radius, relative: a scale error that no sensor on the robot can detect
    ratio_sigma: float = 0.01  # right radius / left radius, relative
    base_sigma: float = 0.01  # wheel base, relative
    max_speed_m_s: float = 3.0  # of a wheel; a faster motion means that the counter was restarted
    silence_s: float = 0.5  # without a sample for so long the wheels count as silent

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges(
            "wheels",
            self,
            noise_m_per_sqrt_m=(1e-5, 1.0),
            radius_sigma=(0.0, 0.2),
            ratio_sigma=(1e-6, 0.2),
            base_sigma=(1e-6, 0.2),
            max_speed_m_s=(0.1, 50.0),
            silence_s=(0.05, 10.0),
        )


@dataclass(frozen=True)
class VisualConfig:
    """Error model of the camera's motion between two keyframes.

    Lengths are in units of the visual odometry, whose mean depth is about 1 when a segment begins: errors of a camera
    are angles, so in these units they do not depend on the height of the ceiling.
    """

    translation_sigma: float = 1.5e-4  # per axis, keyframe to keyframe
    yaw_sigma_rad: float = 2e-4
    robust_threshold: float = 4.0  # in sigmas: beyond it the influence of a measurement no longer grows (Huber)
    tilt_limit_rad: float = 0.03  # a step that tilts the robot more is not possible on a floor and is not used
    stray_limit: float = 0.005  # nor one that moves it up or sideways by more, units
    stray_share: float = 0.1  # plus this share of its distance, because the mounting is not known exactly
    silence_s: float = 1.0  # without a tracked frame for this time the camera counts as silent

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges(
            "visual",
            self,
            translation_sigma=(1e-7, 0.1),
            yaw_sigma_rad=(1e-7, 0.1),
            robust_threshold=(1.0, 100.0),
            tilt_limit_rad=(0.001, 1.0),
            stray_limit=(0.001, 1.0),
            stray_share=(0.0, 1.0),
            silence_s=(0.05, 10.0),
        )


@dataclass(frozen=True)
class ScaleConfig:
    """The scale: metres per unit of the visual odometry. Sigmas are of its logarithm."""

    ceiling_height_m: Optional[float] = None  # above the camera: about one VO unit, so an initial scale
    height_sigma: float = 0.3  # of that guess, and of a new segment's by the height of the ceiling before
    walk_sigma: float = 4e-4  # drift over a way of one unit
    converged_sigma: float = 0.005  # below it the scale is known
    lost_sigma: float = 0.02  # above this sigma the scale is no longer known

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges("scale", self, height_sigma=(0.01, 2.0), walk_sigma=(1e-6, 0.1))
        require_ranges("scale", self, converged_sigma=(1e-4, self.lost_sigma), lost_sigma=(1e-4, 0.5))
        if self.ceiling_height_m is not None:
            require_ranges("scale", self, ceiling_height_m=(0.2, 100.0))


@dataclass(frozen=True)
class GraphConfig:
    """The window of the live estimate."""

    window: int = 20  # keyframes; older ones become a prior
    estimate_wheels: bool = False  # refine wheel ratio, wheel base and the camera's yaw while driving
    camera_yaw_sigma_rad: float = 0.01  # prior of that yaw

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges("graph", self, window=(10, 200), camera_yaw_sigma_rad=(1e-5, 0.2))


@dataclass(frozen=True)
class SlipConfig:
    """When a difference between wheels and camera counts as slip or as a jump of the scale, and for how long."""

    gate: float = 25.0  # squared normalised difference (chi-square, one degree of freedom): 5 sigma
    # The same between images. Of the 70 million comparisons of a week, turn and distance over two baselines at 30
    # images a second, 42 are beyond 5 sigma by chance, and one in 7 weeks is beyond 6.
    image_gate: float = 36.0
    jump_steps: int = 6  # this many distances in a row, wrong by one factor, are a jump of the scale or a steady slip
    report_gap_s: float = 1.0  # slips closer than this are one report
    longest_s: float = 2.0  # longest time that a camera that stands may contradict the wheels

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges("slip", self, gate=(4.0, 1000.0), image_gate=(4.0, 1000.0), jump_steps=(3, 20))
        require_ranges("slip", self, report_gap_s=(0.0, 60.0), longest_s=(0.1, 60.0))


@dataclass(frozen=True)
class OutputConfig:
    """How corrections are applied to the published pose."""

    blend_s: float = 0.1  # time constant with which corrections are applied
    max_correction_m_s: float = 0.25  # fastest correction
    max_correction_rad_s: float = 0.5
    acceleration_m_s2: float = 2.0  # the robot's largest, for the filter of the twist
    acceleration_rad_s2: float = 4.0

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require_ranges(
            "output",
            self,
            blend_s=(0.01, 10.0),
            max_correction_m_s=(0.005, 5.0),
            max_correction_rad_s=(0.005, 10.0),
            acceleration_m_s2=(0.01, 100.0),
            acceleration_rad_s2=(0.01, 100.0),
        )


@dataclass(frozen=True)
class FusionConfig:
    """All settings of `FusionEstimator`."""

    wheels: WheelConfig = field(default_factory=WheelConfig)
    visual: VisualConfig = field(default_factory=VisualConfig)
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    slip: SlipConfig = field(default_factory=SlipConfig)
    output: OutputConfig = field(default_factory=OutputConfig)

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        for part in (self.wheels, self.visual, self.scale, self.graph, self.slip, self.output):
            part.check()
        require(
            self.slip.jump_steps < self.graph.window,
            f"slip.jump_steps={self.slip.jump_steps}: below graph.window ({self.graph.window}), which must still hold "
            "the keyframe at which the scale jumped",
        )
