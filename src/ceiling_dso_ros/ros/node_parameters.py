"""The parameters of each node beside the settings of the odometry and the fusion: private, with working defaults."""

from dataclasses import dataclass, field
from types import ModuleType
from typing import Sequence

from ceiling_dso_ros.cfg import DsoConfig, FusionConfig
from ceiling_dso_ros.dso.config import require
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.image_scaling import parse_image_size

SILENCE_S = (0.1, 60.0)


def _require_range(parameters: object, name: str, smallest: float, largest: float) -> None:
    value = getattr(parameters, name)
    require(smallest <= value <= largest, f"{name}={value}: {smallest:g} to {largest:g}")


def _require_choice(parameters: object, name: str, choices: Sequence[str]) -> None:
    value = getattr(parameters, name)
    require(value in choices, f"{name}={value}: {' or '.join(choices)}")


def _require_frames(parameters: object, *names: str) -> None:
    for name in names:
        require(bool(getattr(parameters, name).strip("/ ")), f"{name}={getattr(parameters, name)}: the name of a frame")


def _require_configurable(parameters: object, config: ModuleType) -> None:
    """Those that dynamic_reconfigure offers are within its ranges."""
    for name in config.defaults:
        if name != "groups":
            _require_range(parameters, name, config.min[name], config.max[name])


@dataclass(frozen=True)
class DsoParameters:
    """Of dso_node; the settings of the odometry lie beside them."""

    image_transport: str = "raw"  # or compressed
    calibration: str = ""  # camera.txt in the TUM-mono layout, instead of camera_info
    rectified: bool = False  # images are those that P of camera_info describes, not K and D
    image_size: str = ""  # WIDTHxHEIGHT that the images are scaled down to; their own by default
    frame_rate: float = DsoConfig.defaults["frame_rate"]  # images a second that are tracked; 0 for all
    # live, beside the tracking, so that a pose never waits for it; or sequential, which gives what `run` gives with the
    # images that are not dropped
    mapping: str = "live"
    # Let the wheels predict the camera's motion; not by default, as then a bag gives the same poses however fast the
    # machine is.
    motion_prediction: bool = False
    vo_frame: str = "vo"  # world of the visual odometry; its unit of length is not the metre
    camera_frame: str = ""  # optical frame of the camera; that of the images by default
    silence: float = 0.5  # seconds without an image after which the diagnostics say so
    keep_trajectory: bool = True  # remember what ~save_trajectory writes, 30 MB an hour at 30 images a second
    trajectory_dir: str = ""  # folder to which that is written when the node ends; not at all by default
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
        _require_configurable(self, DsoConfig)
        if self.image_size:
            try:
                parse_image_size(self.image_size, "image_size")
            except InputError as error:
                require(False, str(error))


@dataclass(frozen=True)
class WheelParameters:
    """Of wheel_odometry_node; `robot` lies beside them."""

    input: str = "joint_states"  # or ticks
    left_joint: str = ""  # name in joint_states; the one that contains left by default
    right_joint: str = ""
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    publish_tf: bool = False  # the fusion publishes a better transform
    silence: float = 0.5  # seconds without a sample after which the diagnostics say so
    wheels: WheelConfig = field(default_factory=WheelConfig)  # how far they can be trusted

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        self.wheels.check()
        _require_choice(self, "input", ("joint_states", "ticks"))
        _require_frames(self, "odom_frame", "base_frame")
        _require_range(self, "silence", *SILENCE_S)


@dataclass(frozen=True)
class FusionParameters:
    """Of fusion_node; the settings of the fusion lie beside them, and `robot`."""

    odom_frame: str = "odom"
    base_frame: str = "base_link"
    camera_frame: str = ""  # looked up in tf where robot has no T_base_camera; the visual odometry's by default
    publish_tf: bool = True
    # odom: odom_frame -> base_frame; correction: odom_frame -> the frame of wheel/odometry, for a wheel driver that
    # publishes the transform of base_frame itself
    tf_mode: str = "odom"
    silence: float = 0.5  # seconds without wheel odometry or images after which the diagnostics say so
    keep_trajectory: bool = True  # remember what ~save_trajectory writes, about 10 MB an hour
    trajectory_dir: str = ""  # folder to which that is written when the node ends; not at all by default
    covariance_scale: float = FusionConfig.defaults["covariance_scale"]  # this and the rest: see cfg/Fusion.cfg
    path_length: int = FusionConfig.defaults["path_length"]
    path_period: float = FusionConfig.defaults["path_period"]

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_frames(self, "odom_frame", "base_frame")
        _require_choice(self, "tf_mode", ("odom", "correction"))
        _require_range(self, "silence", *SILENCE_S)
        _require_configurable(self, FusionConfig)


@dataclass(frozen=True)
class SimulationParameters:
    """Of simulation_node."""

    sequence: str = "loops"  # square, loops, straight, spin or stop_and_go
    ceiling: str = "factory"  # factory, tiles, warehouse or plaster
    seed: int = 0  # of everything random
    duration: float = 0.0  # seconds, 0.5 to 7200; 0 for one lap
    rate: float = 1.0  # how many simulated seconds shall pass in one; where rendering takes longer, fewer do
    events: str = ""  # what happens, comma-separated, as `simulate --event` takes them

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        _require_range(self, "seed", 0, 2**31 - 1)  # the parameter server's largest
        _require_range(self, "duration", 0.0, 7200.0)
        _require_range(self, "rate", 0.01, 100.0)
