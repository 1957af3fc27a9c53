# SPDX-License-Identifier: BSD-3-Clause
"""Every setting out of its range is refused by name."""

from dataclasses import fields

import numpy as np
import pytest

from ceiling_dso_ros.dso.config import (
    ActivationConfig,
    ConfigError,
    InitializationConfig,
    KeyframeConfig,
    OdometryConfig,
    OptimizationConfig,
    TracingConfig,
    TrackingConfig,
    WindowConfig,
)

BAD = [
    (WindowConfig, "max_keyframes", 2),
    (WindowConfig, "max_keyframes", 31),
    (WindowConfig, "min_keyframes", 1),
    (WindowConfig, "min_keyframes", 30),
    (WindowConfig, "candidate_points", 49),
    (WindowConfig, "candidate_points", 20001),
    (WindowConfig, "active_points", 0),
    (WindowConfig, "active_points", 20001),
    (InitializationConfig, "min_texture", -1.0),
    (InitializationConfig, "min_point_texture", -1.0),
    (InitializationConfig, "densities", ()),
    (InitializationConfig, "densities", (0.5, 0.0)),
    (InitializationConfig, "densities", (0.5, 1.1)),
    (InitializationConfig, "min_translation", 0.0),
    (InitializationConfig, "min_translation", 1.1),
    (TrackingConfig, "cutoff", 0.0),
    (TrackingConfig, "cutoff", -20.0),
    (TrackingConfig, "max_rmse_growth", 1.0),
    (TracingConfig, "reach", 0.0),
    (TracingConfig, "reach", 0.1),
    (ActivationConfig, "iterations", 0),
    (ActivationConfig, "max_interval", 0.0),
    (OptimizationConfig, "iterations", 0),
    (OptimizationConfig, "iterations", 51),
    (OptimizationConfig, "first_iterations", 0),
    (OptimizationConfig, "first_iterations", 51),
    (OptimizationConfig, "marginalization_weight", 0.0),
    (OptimizationConfig, "marginalization_weight", 1.1),
    (OptimizationConfig, "intrinsics_information", -1.0),
    (KeyframeConfig, "translation_weight", -1.0),
    (KeyframeConfig, "motion_weight", -1.0),
    (KeyframeConfig, "brightness_weight", -1.0),
]
PART = {type(getattr(OdometryConfig(), part.name)): part.name for part in fields(OdometryConfig)}


def test_defaults_are_valid():
    OdometryConfig().check()


@pytest.mark.parametrize(("kind", "name", "value"), BAD)
def test_a_value_out_of_range_is_refused_by_name(kind, name, value):
    bad = kind(**{name: value})
    with pytest.raises(ConfigError, match=rf"{PART[kind]}\.{name}\b"):
        bad.check()
    with pytest.raises(ConfigError, match=rf"{PART[kind]}\.{name}\b"):
        OdometryConfig(**{PART[kind]: bad}).check()


@pytest.mark.parametrize(("kind", "name"), sorted({(k, n) for k, n, v in BAD if isinstance(v, (int, float))}, key=str))
def test_nan_is_refused(kind, name):
    with pytest.raises(ConfigError, match=name):
        kind(**{name: np.nan}).check()


def test_the_message_says_the_value_and_what_is_allowed():
    with pytest.raises(ConfigError, match=r"window\.max_keyframes=2: 3 to 30"):
        WindowConfig(max_keyframes=2).check()


def test_config_errors_are_value_errors():
    assert issubclass(ConfigError, ValueError)
