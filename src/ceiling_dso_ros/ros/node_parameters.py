# SPDX-License-Identifier: BSD-3-Clause
"""The private parameters of each node with their defaults, except the settings of the odometry and the fusion."""

from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, Sequence

from ceiling_dso_ros.cfg import DsoConfig, FusionConfig, RealsenseConfig
from ceiling_dso_ros.drivers.settings import CameraSettings, ExposureSettings, Mode
from ceiling_dso_ros.dso.config import require
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.frame_rate import parse_frame_rate
from ceiling_dso_ros.io.grey_range import check_bits
from ceiling_dso_ros.io.image_scaling import parse_image_size

SILENCE_S = (0.1, 60.0)
LIMIT_MB = (10, 1_000_000)


def _require_range(parameters: object, name: str, smallest: float, largest: float) -> None:
    value = getattr(parameters, name)
    require(smallest <= value <= largest, f"{name}={value}: {smallest:g} to {largest:g}")


def _require_choice(parameters: object, name: str, choices: Sequence[str]) -> None:
    value = getattr(parameters, name)
    require(value in choices, f"{name}={value}: {' or '.join(choices)}")


def _require_frames(parameters: object, *names: str) -> None:
    for name in names:
        require(bool(getattr(parameters, name).strip("/ ")), f"{name}={getattr(parameters, name)}: the name of a frame")


def _require_odom_and_base(parameters: object) -> None:
    _require_frames(parameters, "odom_frame", "base_frame")
    odom_frame, base_frame = (getattr(parameters, name).lstrip("/") for name in ("odom_frame", "base_frame"))
    require(odom_frame != base_frame, f"odom_frame and base_frame are both {odom_frame}: two frames are needed")


def _require_configurable(parameters: object, config: ModuleType) -> None:
    """Check the numbers of dynamic_reconfigure against its ranges."""
    for name, value in config.defaults.items():
        if isinstance(value, (int, float)):
            _require_range(parameters, name, config.min[name], config.max[name])


@dataclass(frozen=True)
class DsoParameters:
    """Parameters of dso_node; the settings of the odometry are on the same level."""

    image_transport: str = "raw"  # or compressed
    calibration: str = ""  # camera.txt in the TUM-mono layout, instead of camera_info
    rectified: bool = False  # images are rectified: P of camera_info describes them, not K and D
    bit_depth: int = 0  # of 16 bit images, 8 to 16, such as 12; 0 to find it from the images
    image_size: str = ""  # WIDTHxHEIGHT that the images are scaled down to; their own by default
    # Largest number of images tracked per second; 0 for all; auto: fewer while hardly anything moves
    frame_rate: str = DsoConfig.defaults["frame_rate"]
    # live: in its own thread, so that poses do not wait for it. sequential: the same result as `run` with the images
    # that are not dropped
    mapping: str = "live"
    # Predict the camera's motion from the wheels. Off by default, because then the poses of a bag do not depend on the
    # speed of the machine.
    motion_prediction: bool = False
    vo_frame: str = "vo"  # world of the visual odometry; its unit of length is not the metre
    camera_frame: str = ""  # optical frame of the camera; that of the images by default
    silence: float = 0.5  # seconds without an image after which the diagnostics report it
    keep_trajectory: bool = True  # keep trajectories on the disk for ~save_trajectory: about 25 MB per hour
    trajectory_limit_mb: int = 1000  # largest size of that; the oldest part is given up when it is reached
    trajectory_dir: str = ""  # folder to which trajectories are written when the node ends; not at all by default
    covariance_scale: float = DsoConfig.defaults["covariance_scale"]  # this and the rest: see cfg/Dso.cfg
    path_length: int = DsoConfig.defaults["path_length"]
    path_period: float = DsoConfig.defaults["path_period"]
    map_period: float = DsoConfig.defaults["map_period"]

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_choice(self, "image_transport", ("raw", "compressed"))
        _require_choice(self, "mapping", ("live", "sequential"))
        _require_frames(self, "vo_frame")
        _require_range(self, "silence", *SILENCE_S)
        _require_range(self, "trajectory_limit_mb", *LIMIT_MB)
        _require_configurable(self, DsoConfig)
        require(
            not (self.rectified and self.calibration),
            "rectified=true means P of camera_info, which calibration replaces: for rectified images, that file has "
            "the line 'Pinhole fx fy cx cy 0'",
        )
        try:
            check_bits(self.bit_depth, "bit_depth")
            parse_frame_rate(self.frame_rate, "frame_rate=")
            if self.image_size:
                parse_image_size(self.image_size, "image_size")
        except InputError as error:
            require(False, str(error))


@dataclass(frozen=True)
class WheelParameters:
    """Parameters of wheel_odometry_node; `robot` is on the same level."""

    input: str = "joint_states"  # or ticks
    left_joint: str = ""  # name in joint_states; found by default, see `WheelJoints`
    right_joint: str = ""
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    publish_tf: bool = False  # the fusion publishes a better transform
    silence: float = 0.5  # seconds without a sample after which the diagnostics report it
    wheels: WheelConfig = field(default_factory=WheelConfig)  # error model

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        self.wheels.check()
        _require_choice(self, "input", ("joint_states", "ticks"))
        joint = self.left_joint
        require(not joint or joint != self.right_joint, f"left_joint and right_joint are both {joint}: two are needed")
        _require_odom_and_base(self)
        _require_range(self, "silence", *SILENCE_S)


@dataclass(frozen=True)
class FusionParameters:
    """Parameters of fusion_node; the settings of the fusion and `robot` are on the same level."""

    odom_frame: str = "odom"
    base_frame: str = "base_link"
    camera_frame: str = ""  # looked up in tf where robot has no T_base_camera; the visual odometry's by default
    publish_tf: bool = True
    # odom: odom_frame -> base_frame; correction: odom_frame -> the frame of wheel/odometry, for a wheel driver that
    # publishes the transform of base_frame itself
    tf_mode: str = "odom"
    silence: float = 0.5  # seconds without wheel odometry or images after which the diagnostics report it
    keep_trajectory: bool = True  # keep trajectories on the disk for ~save_trajectory: about 45 MB per hour
    trajectory_limit_mb: int = 1000  # largest size of that; the oldest part is given up when it is reached
    trajectory_dir: str = ""  # folder to which trajectories are written when the node ends; not at all by default
    covariance_scale: float = FusionConfig.defaults["covariance_scale"]  # this and the rest: see cfg/Fusion.cfg
    path_length: int = FusionConfig.defaults["path_length"]
    path_period: float = FusionConfig.defaults["path_period"]

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_odom_and_base(self)
        _require_choice(self, "tf_mode", ("odom", "correction"))
        _require_range(self, "silence", *SILENCE_S)
        _require_range(self, "trajectory_limit_mb", *LIMIT_MB)
        _require_configurable(self, FusionConfig)


@dataclass(frozen=True)
class MapParameters:
    """Parameters of map_node."""

    map: str = ""  # file of the map to begin with; none by default
    mapping: bool = True  # build the map; false: only find the robot in it
    save: str = ""  # file to which the map is written when the node ends; not at all by default
    map_frame: str = "map"
    odom_frame: str = "odom"  # frame of odometry/filtered
    publish_tf: bool = True
    transform_tolerance: float = 0.1  # seconds by which map -> odom is stamped ahead
    silence: float = 0.5  # seconds without odometry until the diagnostics report it

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_frames(self, "map_frame", "odom_frame")
        map_frame, odom_frame = self.map_frame.lstrip("/"), self.odom_frame.lstrip("/")
        require(map_frame != odom_frame, f"map_frame and odom_frame are both {map_frame}: two frames are needed")
        _require_range(self, "transform_tolerance", 0.0, 10.0)
        _require_range(self, "silence", *SILENCE_S)


@dataclass(frozen=True)
class SimulationParameters:
    """Parameters of simulation_node."""

    # sequence: along a planned path; cmd_vel: as it is commanded, from where the sequence starts
    drive: str = "sequence"
    sequence: str = "loops"  # square, loops, straight, spin or stop_and_go
    ceiling: str = "factory"  # factory, tiles, warehouse, plaster or random
    seed: int = 0  # seed of all random choices
    duration: float = 0.0  # seconds, 0.5 to 7200; 0 for one lap, or without an end where it is commanded
    rate: float = 1.0  # simulated seconds per real second; less if rendering takes longer; 0 for as many as possible
    wait_for: str = ""  # topics, comma-separated, on which nodes answer images: the next one waits for the answers
    map_to_odom: bool = True  # publish this transform, true at the start; false where a localisation publishes it
    camera_size: str = "848x480"  # WIDTHxHEIGHT, multiples of 4
    camera_rate: float = 30.0  # images per second, 1 to 120
    stereo: bool = False  # a second upward camera
    events: str = ""  # events, comma-separated, in the format of `simulate --event`

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_range(self, "seed", 0, 2**31 - 1)  # largest integer of the parameter server
        _require_range(self, "duration", 0.0, 7200.0)
        _require_choice(self, "drive", ("sequence", "cmd_vel"))
        require(self.rate == 0.0 or 0.01 <= self.rate <= 100.0, f"rate={self.rate}: 0.01 to 100, or 0")


@dataclass(frozen=True)
class RealsenseParameters:
    """Parameters of realsense_node."""

    serial_no: str = ""  # of the camera; the only one that is connected by default
    camera_size: str = "848x480"  # WIDTHxHEIGHT; the camera's nearest mode is used
    camera_rate: int = 30  # images per second, 6 to 90
    stereo: bool = False  # publish the right images too
    imu: bool = False  # publish angular rates and accelerations
    camera_frame: str = "camera_up_optical_frame"  # optical frame of the left images
    recording: str = ""  # file of realsense-viewer or rs.recorder that is played instead of a camera, again and again
    silence: float = 0.5  # seconds without an image after which the diagnostics report it
    fixed_exposure_ms: float = RealsenseConfig.defaults["fixed_exposure_ms"]  # this and the rest: see cfg/Realsense.cfg
    fixed_gain: int = RealsenseConfig.defaults["fixed_gain"]
    exposure_limit_ms: float = RealsenseConfig.defaults["exposure_limit_ms"]
    gain_limit: int = RealsenseConfig.defaults["gain_limit"]
    metering: float = RealsenseConfig.defaults["metering"]

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_frames(self, "camera_frame")
        _require_range(self, "silence", *SILENCE_S)
        _require_configurable(self, RealsenseConfig)
        try:
            camera_settings(self).check()
        except InputError as error:
            require(False, str(error))


def camera_settings(parameters: RealsenseParameters) -> CameraSettings:
    """What realsense_node asks of the camera.

    Raises:
        InputError: the size of the images is none.
    """
    width, height = parse_image_size(parameters.camera_size, "camera_size")
    return CameraSettings(
        serial_no=parameters.serial_no.strip(),
        mode=Mode(width, height, parameters.camera_rate),
        stereo=parameters.stereo,
        imu=parameters.imu,
        exposure=exposure_settings(parameters),
        recording=parameters.recording,
    )


def exposure_settings(parameters: Any) -> ExposureSettings:  # noqa: ANN401
    """How the camera exposes, by RealsenseParameters or what dynamic_reconfigure has of them."""
    return ExposureSettings(
        fixed_ms=parameters.fixed_exposure_ms,
        fixed_gain=parameters.fixed_gain,
        limit_ms=parameters.exposure_limit_ms,
        gain_limit=parameters.gain_limit,
        metering=parameters.metering,
    )
