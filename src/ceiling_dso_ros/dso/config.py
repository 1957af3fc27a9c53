"""Settings of the odometry: frozen dataclasses with working defaults, one per stage.

The defaults are the constants of the published method; where a measured alternative is better the comment says so.
"""

from dataclasses import dataclass, field


class ConfigError(ValueError):
    """A setting is outside its range; the message names it, its value and what is allowed."""


def require(condition: bool, message: str) -> None:
    """Raise ConfigError with message unless condition holds."""
    if not condition:
        raise ConfigError(message)


@dataclass(frozen=True)
class WindowConfig:
    """The keyframe window and its points."""

    max_keyframes: int = 7
    candidate_points: int = 1500
    active_points: int = 2000

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        require(3 <= self.max_keyframes <= 30, f"window.max_keyframes={self.max_keyframes}: 3 to 30")
        require(50 <= self.candidate_points <= 20000, f"window.candidate_points={self.candidate_points}: 50 to 20000")
        require(50 <= self.active_points <= 20000, f"window.active_points={self.active_points}: 50 to 20000")


@dataclass(frozen=True)
class OdometryConfig:
    """All settings of `DirectOdometry`."""

    window: WindowConfig = field(default_factory=WindowConfig)

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        self.window.check()
