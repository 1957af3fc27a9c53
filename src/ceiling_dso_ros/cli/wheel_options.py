# SPDX-License-Identifier: BSD-3-Clause
"""Options of all commands that use the wheels of a recording; the launch files have the same names."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Dict, Tuple

from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.io.recording import Recording, RobotDescription, WheelSamples

# Option -> the field of TopicNames.
TOPICS = {
    "joint_states": ("joint_states", "sensor_msgs/JointState with the wheel angles (default /joint_states)"),
    "left_ticks": ("ticks", "std_msgs/Int32 (default /wheel/left/ticks)"),
    "right_ticks": ("ticks", "std_msgs/Int32 (default /wheel/right/ticks)"),
    "wheel_odometry": ("odometry", "nav_msgs/Odometry of the robot's own, used instead of its wheels (default /odom)"),
}
NAMES = {
    "left_joint": ("joint_states", "name of the left wheel in joint_states (default: found where there is no doubt)"),
    "right_joint": ("joint_states", "name of the right wheel in joint_states"),
    "base_frame": ("", "robot frame, on the floor between the wheels (default base_link)"),
    "camera_frame": ("", "the camera's optical frame (default: that of the images)"),
}


def add_wheel_options(parser: argparse.ArgumentParser) -> None:
    """Add them."""
    group = parser.add_argument_group("wheels of a bag")
    group.add_argument("--robot", metavar="robot.yaml", type=Path, help="dimensions to use instead of the recording's")
    group.add_argument(
        "--wheel-input",
        choices=("ticks", "joint_states", "odometry"),
        help="which data is used (default: that of the options below, else ticks if there are some, else joint_states)",
    )
    for options, metavar in ((TOPICS, "TOPIC"), (NAMES, "NAME")):
        for name, (_, text) in options.items():
            group.add_argument(f"--{name.replace('_', '-')}", metavar=metavar, help=text)


def topics_of_wheels(options: argparse.Namespace) -> Dict[str, str]:
    """The arguments of TopicNames that were given; none for a command without these options.

    Raises:
        InputError: two options contradict each other.
    """
    values = vars(options)
    given = {name: values[name] for name in (*TOPICS, *NAMES) if values.get(name) is not None}
    if given.get("left_joint") is not None and given.get("left_joint") == given.get("right_joint"):
        raise InputError(f"--left-joint and --right-joint are both {given['left_joint']}: two are needed")
    implied = {kind: name for name in given for kind in [{**TOPICS, **NAMES}[name][0]] if kind}
    asked = values.get("wheel_input") or ""
    for kind, name in implied.items():
        if kind != (asked or next(iter(implied))):
            other = f"--wheel-input {asked}" if asked else f"--{next(iter(implied.values())).replace('_', '-')}"
            raise InputError(f"--{name.replace('_', '-')} and {other} name different data; one of them is used")
    return {**given, "wheel_input": asked or next(iter(implied), "")}


def require_usable(recording: "Recording") -> "Tuple[WheelSamples, RobotDescription]":
    """The wheels of a recording and the robot's dimensions, for a command that needs them.

    Raises:
        InputError: there are no wheels, the dimensions are unknown, or the wheels do not belong to the images.
    """
    from ceiling_dso_ros.playback.wheel_check import why_unusable

    wheels = recording.wheels
    if wheels is None or len(wheels) < 2:
        raise InputError(f"{recording.path}: has no wheels; record joint_states, ticks or encoders.csv")
    problem, robot = why_unusable(recording, wheels), recording.robot
    if problem or robot is None:
        raise InputError(problem)
    return wheels, robot
