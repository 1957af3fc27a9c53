# SPDX-License-Identifier: BSD-3-Clause
import dataclasses

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.fusion.config import FusionConfig, GraphConfig, RobotModel, ScaleConfig, WheelConfig


def test_the_defaults_are_in_range():
    FusionConfig().check()


@pytest.mark.parametrize(
    ("part", "name"),
    [
        (FusionConfig(wheels=WheelConfig(noise_m_per_sqrt_m=-1.0)), "wheels.noise_m_per_sqrt_m=-1.0: 1e-05 to 1"),
        (FusionConfig(scale=ScaleConfig(ceiling_height_m=0.0)), "scale.ceiling_height_m=0.0: 0.2 to 100"),
        (FusionConfig(scale=ScaleConfig(converged_sigma=0.1)), "scale.converged_sigma=0.1"),
        (FusionConfig(graph=GraphConfig(window=2)), "graph.window=2: 10 to 200"),
        (FusionConfig(wheels=WheelConfig(radius_sigma=float("nan"))), "wheels.radius_sigma=nan"),
    ],
)
def test_a_value_out_of_range_is_named_with_its_range(part, name):
    with pytest.raises(ConfigError, match=name):
        part.check()


def test_every_number_has_a_range():
    """Half of the largest float is in nobody's range."""
    for field in dataclasses.fields(FusionConfig):
        part = getattr(FusionConfig(), field.name)
        for setting in dataclasses.fields(part):
            if isinstance(getattr(part, setting.name), bool):
                continue
            with pytest.raises(ConfigError):
                dataclasses.replace(part, **{setting.name: 1e300}).check()


def test_settings_go_through_yaml():
    text = OmegaConf.to_yaml(OmegaConf.structured(FusionConfig(scale=ScaleConfig(ceiling_height_m=5.5))))
    read = FusionConfig(scale=ScaleConfig(**yaml.safe_load(text)["scale"]))
    assert read.scale.ceiling_height_m == 5.5


def looking_down():
    return np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T_base_camera": looking_down()}, "must look up"),
        ({"T_base_camera": np.eye(3)}, "not a rigid motion"),
        ({"T_base_camera": 2 * np.eye(4)}, "not a rigid motion"),
        ({"T_base_camera": np.full((4, 4), np.nan)}, "not a rigid motion"),
        ({"wheel_base_m": 0.0}, "robot.wheel_base_m=0.0: 0.01 to 20"),
        ({"wheel_radius_m": (0.1, 0.0)}, "robot.wheel_radius_m: 0.005 to 5"),
        ({"ticks_per_turn": 0.0}, "robot.ticks_per_turn"),
        ({"camera_time_offset_s": 3.0}, "robot.camera_time_offset_s"),
    ],
)
def test_an_impossible_robot_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        RobotModel(**{"T_base_camera": np.eye(4), "wheel_base_m": 0.5, **changes})
