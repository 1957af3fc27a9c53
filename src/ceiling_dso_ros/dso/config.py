# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the odometry: frozen dataclasses with working defaults, one per stage.

The defaults are the constants of the published method; where a measured alternative is better the comment says so.
"""

from dataclasses import dataclass, field, fields
from typing import Tuple


class ConfigError(ValueError):
    """A setting is outside its range; the message names it, its value and what is allowed."""


def require(condition: bool, message: str) -> None:
    """Raise ConfigError with message unless condition holds."""
    if not condition:
        raise ConfigError(message)


@dataclass(frozen=True)
class ImageConfig:
    """What is done with an image before anything else."""

    # Standard deviation in grey levels: the images of a noisier camera are smoothed. It moves the points with the
    # smallest gradients that are selected, 7 grey levels per pixel, by up to (1.4 / 7)^2 / 4 = 0.01 pixels.
    max_noise: float = 1.4
    vignetting: bool = True  # estimate how much darker the corners of the image are, and correct it

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(self.max_noise >= 0, f"images.max_noise={self.max_noise}: not negative")


@dataclass(frozen=True)
class WindowConfig:
    """The keyframe window and its points."""

    max_keyframes: int = 10  # with the published 7 (and 2000 points) the scale drifts more at depth edges
    min_keyframes: int = 5  # keyframes with few points are not removed while there are no more than this
    candidate_points: int = 1500  # new ones per keyframe
    active_points: int = 1000  # in the whole window
    min_active_share: float = 0.1  # with a smaller share of active_points, tracking is lost

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(3 <= self.max_keyframes <= 30, f"window.max_keyframes={self.max_keyframes}: 3 to 30")
        require(
            2 <= self.min_keyframes <= self.max_keyframes,
            f"window.min_keyframes={self.min_keyframes}: 2 to window.max_keyframes ({self.max_keyframes})",
        )
        require(50 <= self.candidate_points <= 20000, f"window.candidate_points={self.candidate_points}: 50 to 20000")
        require(0 <= self.min_active_share < 1, f"window.min_active_share={self.min_active_share}: 0 to 1")
        require(50 <= self.active_points <= 20000, f"window.active_points={self.active_points}: 50 to 20000")


@dataclass(frozen=True)
class InitializationConfig:
    """The first map from frames with parallax."""

    densities: Tuple[float, ...] = (0.03, 0.05, 0.15, 0.5, 1.0)  # share of pixels per level, finest first
    min_translation: float = 0.016  # of the mean depth, before depths are estimated
    frames_after_snap: int = 5
    max_translation: float = 0.12  # of the mean depth; beyond it the map is made at once
    max_frames: int = 300  # after this many frames without a map the first frame is replaced
    max_rmse: float = 10.0  # grey levels; a first map with a larger error is not accepted
    min_share: float = 0.3  # of the wanted active points that a first map must have
    min_texture: float = 30.0  # as tracking.min_texture, of the first frame on its map; stricter than while tracking
    min_point_texture: float = 12.0  # median squared gradient of the points of a first map, over that of noise
    flat_coupling: float = 22500.0  # information that pulls depths to the plane before that
    translation_coupling: float = 2000.0  # and the translation to zero; with more, rotation may look like translation
    depth_coupling: float = 1.0  # and to their neighbours' median afterwards

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(
            len(self.densities) > 0 and all(0 < density <= 1 for density in self.densities),
            f"initialization.densities={self.densities}: above 0, at most 1",
        )
        require(
            0.001 <= self.min_translation <= 1,
            f"initialization.min_translation={self.min_translation}: 0.001 to 1 of the mean depth",
        )
        require(
            self.max_translation > self.min_translation,
            f"initialization.max_translation={self.max_translation}: above initialization.min_translation",
        )
        require(0 <= self.min_share < 1, f"initialization.min_share={self.min_share}: 0 to 1")
        require(self.min_texture >= 0, f"initialization.min_texture={self.min_texture}: not negative")
        require(self.min_point_texture >= 0, f"initialization.min_point_texture={self.min_point_texture}: not negative")
        require(self.max_rmse > 0, f"initialization.max_rmse={self.max_rmse}: positive grey levels")


@dataclass(frozen=True)
class TrackingConfig:
    """Coarse-to-fine tracking of a new frame against the newest keyframe."""

    cutoff: float = 20.0  # grey levels
    affine_a_information: float = 0.0  # information per point that pulls a towards the keyframe's
    affine_b_information: float = 0.0
    max_rmse_growth: float = 1.5  # relative to the best error; above it a hypothesis is rejected, below it accepted
    min_texture: float = 2.0  # squared gradient over that of noise, along the worst motion; below it there is no pose
    patience: float = 1.0  # seconds without a pose until the map is given up; so long every image is tried on it

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(self.cutoff > 0, f"tracking.cutoff={self.cutoff}: positive grey levels")
        require(self.min_texture >= 0, f"tracking.min_texture={self.min_texture}: not negative")
        require(0 <= self.patience <= 60, f"tracking.patience={self.patience}: 0 to 60 seconds")
        require(self.max_rmse_growth > 1, f"tracking.max_rmse_growth={self.max_rmse_growth}: above 1")


@dataclass(frozen=True)
class TracingConfig:
    """Search of candidates along their epipolar lines."""

    reach: float = 0.05  # longest search, share of width + height
    depth_margin: float = 3.0  # factor by which the range of known inverse depths is extended for new candidates

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(0.001 <= self.reach <= 0.06, f"tracing.reach={self.reach}: 0.001 to 0.06 of width + height")
        require(self.depth_margin > 1, f"tracing.depth_margin={self.depth_margin}: above 1")


@dataclass(frozen=True)
class ActivationConfig:
    """Promotion of candidates to active points."""

    iterations: int = 3
    min_hessian: float = 50.0
    max_interval: float = 8.0  # pixels
    min_quality: float = 4.0  # second best over best energy of a search; 3 makes the error depend more on the start

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(self.iterations >= 1, f"activation.iterations={self.iterations}: at least 1")
        require(self.max_interval > 0, f"activation.max_interval={self.max_interval}: positive pixels")


@dataclass(frozen=True)
class OptimizationConfig:
    """Windowed bundle adjustment and marginalisation."""

    iterations: int = 6
    first_iterations: int = 15  # while there are fewer than 4 keyframes
    marginalization_weight: float = 0.5
    point_min_hessian: float = 50.0  # points below it are dropped instead of marginalised
    point_min_good_residuals: int = 4
    point_min_live_residuals: int = 3
    intrinsics_information: float = 2e6  # 1 / px^2
    affine_a_information: float = 0.0
    affine_b_information: float = 0.0

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(1 <= self.iterations <= 50, f"optimization.iterations={self.iterations}: 1 to 50")
        require(1 <= self.first_iterations <= 50, f"optimization.first_iterations={self.first_iterations}: 1 to 50")
        require(
            0 < self.marginalization_weight <= 1,
            f"optimization.marginalization_weight={self.marginalization_weight}: above 0, at most 1",
        )
        require(self.intrinsics_information >= 0, "optimization.intrinsics_information: not negative")


@dataclass(frozen=True)
class KeyframeConfig:
    """When a frame becomes a keyframe: the sum of the three terms exceeds one."""

    translation_weight: float = 36.0  # weight of the root mean squared flow by translation, divided by width + height
    motion_weight: float = 18.0  # weight of that of the whole motion
    brightness_weight: float = 2.0  # on |ln alpha|
    max_rmse_growth: float = 2.0  # of the first error on the keyframe
    min_flow: float = 0.5  # pixels; below it the camera stands still, and a growing error does not make a keyframe

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        for name in ("translation_weight", "motion_weight", "brightness_weight", "min_flow"):
            require(getattr(self, name) >= 0, f"keyframe.{name}={getattr(self, name)}: not negative")


@dataclass(frozen=True)
class RigConfig:
    """Errors of the geometry of two cameras, where there is a second one: they do not average out.

    The defaults are those of a camera as it comes from the factory: for a D455 a depth at 4 m is said to be right
    within 2 %, which is 0.2 pixels there, and taken as four standard deviations. One that was calibrated with care is
    better.
    """

    baseline_sigma: float = 0.003  # of the distance of the cameras, relative
    disparity_sigma: float = 0.05  # pixels, of an error that all points in the second image have in common

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        for name, largest in (("baseline_sigma", 0.2), ("disparity_sigma", 5.0)):
            value = getattr(self, name)
            require(0.0 <= value <= largest, f"rig.{name}={value}: 0 to {largest:g}")


@dataclass(frozen=True)
class OdometryConfig:
    """All settings of `DirectOdometry`."""

    images: ImageConfig = field(default_factory=ImageConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    initialization: InitializationConfig = field(default_factory=InitializationConfig)
    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    tracing: TracingConfig = field(default_factory=TracingConfig)
    activation: ActivationConfig = field(default_factory=ActivationConfig)
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    rig: RigConfig = field(default_factory=RigConfig)

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        for part in fields(self):
            getattr(self, part.name).check()
