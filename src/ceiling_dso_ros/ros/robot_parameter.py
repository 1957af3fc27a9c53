"""The robot's dimensions out of the file that `~robot` names."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.robot_file import read_robot_file
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.ros import parameters


class RobotParameter(NamedTuple):
    """The robot, and whether the file says where its camera is; if not, it is taken to look straight up."""

    model: RobotModel
    has_camera: bool


def read_robot() -> RobotParameter:
    """Read the file.

    Raises:
        InputError: none is given, it cannot be read, or a value is missing or out of range.
    """
    path = parameters.path("robot")
    if path is None:
        raise InputError("~robot: give the robot.yaml with ticks_per_turn, wheel_radius and wheel_base")
    straight_up = np.eye(4)
    robot = read_robot_file(path, straight_up)
    try:
        return RobotParameter(robot_model(robot), robot.T_base_camera is not straight_up)
    except ConfigError as error:
        raise InputError(f"{path}: {error}") from error


def with_camera(robot: RobotModel, T_base_camera: np.ndarray) -> RobotModel:
    """The robot with its camera somewhere else.

    Raises:
        ConfigError: the camera does not look up.
    """
    return replace(robot, T_base_camera=T_base_camera)
