# SPDX-License-Identifier: BSD-3-Clause
"""The robot's dimensions from the private parameters `~robot/...`."""

from typing import NamedTuple

import numpy as np
import rospy

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.robot_file import NAMES, robot_from_values, robot_values
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.ros import parameters

ROBOT_GROUP = {"robot": NAMES}


class RobotParameter(NamedTuple):
    """The robot, and whether T_base_camera is given; else a camera that looks straight up is assumed."""

    model: RobotModel
    has_camera: bool


def read_robot() -> RobotParameter:
    """Read the robot's dimensions; all of them are written to the parameter server.

    Raises:
        InputError: there are none, or a value is missing, unknown or out of range.
    """
    source = rospy.resolve_name("~robot")
    values = rospy.get_param("~robot", {})
    if not isinstance(values, dict) or not values:
        raise InputError(
            f"{source}: has no ticks_per_turn, wheel_radius and wheel_base; load a robot.yaml into it, as the launch "
            "files do with robot:=FILE"
        )
    straight_up = np.eye(4)
    robot = robot_from_values(values, source, straight_up)
    try:
        model = robot_model(robot)
    except ConfigError as error:
        raise InputError(f"{source}: {error}") from error
    mount = values.get("T_base_camera", "")
    parameters.write({"robot": {**robot_values(robot), "T_base_camera": mount}}, {"robot": values})
    return RobotParameter(model, mount != "")
