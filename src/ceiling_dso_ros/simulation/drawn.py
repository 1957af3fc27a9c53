# SPDX-License-Identifier: BSD-3-Clause
"""A whole drive drawn at random: hall, camera and wheels."""

from typing import Any, Tuple

import numpy as np

from ceiling_dso_ros.dso.config import require
from ceiling_dso_ros.simulation.camera import NATIVE_WIDTH, CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.robot import Vibration, WheelErrors

RANDOM_CEILING = "random"
LARGEST_FOCAL_ERROR, LARGEST_CENTRE_ERROR_PX, LARGEST_K1_ERROR = 0.01, 5.0, 0.02


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _stream(seed: int, number: int) -> np.random.Generator:
    require(0 <= seed < 2**32, f"seed {seed}: 0 to {2**32 - 1}")
    return np.random.default_rng([seed, number])


def draw_camera(seed: int, **fixed: Any) -> CameraModel:  # noqa: ANN401 each attribute has its own type
    """A camera drawn at random.

    Args:
        seed: of all choices.
        **fixed: attributes that are not drawn.

    Raises:
        ConfigError: the seed is out of range.
    """
    rng = _stream(seed, 1)
    drawn = {
        "read_noise": _between(rng, 0.3, 3.0),
        "shot_noise": _between(rng, 0.8, 4.0),
        "exposure_drift": float(rng.choice([0.0, 0.04, 0.08, 0.15])),
        "response_gamma": float(rng.choice([1.0, 1.0, rng.uniform(0.8, 2.2)])),
        "vignette": float(rng.choice([0.0, rng.uniform(0.0, 0.4)])),
        "blur_px": float(rng.choice([0.0, rng.uniform(0.3, 1.2)])),
        "jpeg_quality": int(rng.choice([0, 0, rng.integers(75, 96)])),
        "exposure_follows": bool(rng.random() < 0.8),
    }
    return CameraModel(**{**drawn, **fixed})


def draw_lens_error(seed: int, width: int) -> Tuple[float, ...]:
    """A wrong calibration drawn at random, `CameraModel.lens_error`, as of a camera that was calibrated some time ago.

    Args:
        seed: of all choices.
        width: of the images, pixels; the principal point is wrong by up to 5 pixels of the native width.

    Raises:
        ConfigError: the seed is out of range.
    """
    rng = _stream(seed, 4)
    centre_px = LARGEST_CENTRE_ERROR_PX * width / NATIVE_WIDTH
    limits = (LARGEST_FOCAL_ERROR, centre_px, centre_px, LARGEST_K1_ERROR)
    return tuple(float(rng.uniform(-limit, limit)) for limit in limits)


def draw_wheels(seed: int, **fixed: float) -> WheelErrors:
    """Wheels drawn at random; in turns they slip by about 1 % at 1 rad/s.

    Args:
        seed: of all choices.
        **fixed: attributes that are not drawn.

    Raises:
        ConfigError: the seed is out of range.
    """
    rng = _stream(seed, 2)
    drawn = {
        "radius": rng.normal(0.0, 0.005),
        "ratio": rng.normal(0.0, 0.005),
        "wheel_base": rng.normal(0.0, 0.01),
        "travel_noise_m": _between(rng, 2e-5, 2e-4),
        "turn_slip": _between(rng, 0.005, 0.02),
    }
    return WheelErrors(**{**drawn, **fixed})


def draw_config(sequence: str, seed: int, **settings: Any) -> SimulationConfig:  # noqa: ANN401 as above
    """A drive under a hall that is drawn at random, with a camera and wheels drawn at random.

    Args:
        sequence: a name of `sequences.SEQUENCES` or `TOURS`.
        seed: of all choices. Those below 100 are for building. 100 to 199 are for judging: nothing is tuned on them.
        **settings: attributes of SimulationConfig that are not drawn.

    Raises:
        ConfigError: the seed is out of range.
    """
    rng = _stream(seed, 3)
    shaking = _between(rng, 0.3, 2.0)
    usual = Vibration()
    drawn = {
        "camera": draw_camera(seed),
        "wheels": draw_wheels(seed),
        "vibration": Vibration(shaking * usual.pitch_deg, shaking * usual.roll_deg, shaking * usual.height_m),
        "exposures_told": bool(rng.random() < 0.6),
    }
    return SimulationConfig(sequence, RANDOM_CEILING, seed, **{**drawn, **settings})
