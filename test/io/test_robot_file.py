# SPDX-License-Identifier: BSD-3-Clause
import re

import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.robot_file import read_robot_file, robot_from_values, robot_values

ROBOT = """
ticks_per_turn: 4096
wheel_radius: [0.098, 0.099]
wheel_base: 0.485
"""
MOUNT = """
T_base_camera:
  xyz: [0.18, 0.04, 0.62]
  quat_xyzw: [0, 0, 1, 1]
"""


def read(tmp_path, text, **arguments):
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    return read_robot_file(path, **arguments)


def test_all_values(tmp_path):
    robot = read(tmp_path, ROBOT + MOUNT)
    assert (robot.ticks_per_turn, robot.wheel_radius_m, robot.wheel_base_m) == (4096, (0.098, 0.099), 0.485)
    expected = [[0, -1, 0, 0.18], [1, 0, 0, 0.04], [0, 0, 1, 0.62], [0, 0, 0, 1]]
    np.testing.assert_allclose(robot.T_base_camera, expected, atol=1e-15)


def test_the_cameras_clock_is_right_unless_the_file_says_otherwise(tmp_path):
    assert read(tmp_path, ROBOT + MOUNT).camera_time_offset_s == 0.0
    assert read(tmp_path, ROBOT + MOUNT + "camera_time_offset: -0.012").camera_time_offset_s == -0.012


def test_the_mount_may_come_from_elsewhere_but_the_file_counts(tmp_path):
    other = np.diag([1.0, -1.0, -1.0, 1.0])
    np.testing.assert_array_equal(read(tmp_path, ROBOT, find_mount=lambda: other).T_base_camera, other)
    assert read(tmp_path, ROBOT + MOUNT, find_mount=lambda: 1 / 0).T_base_camera[0, 3] == 0.18


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a: [1", "is not valid yaml: while parsing a flow sequence"),
        ("just text", "expected the keys ticks_per_turn, wheel_radius, wheel_base, T_base_camera"),
        (ROBOT.replace("4096", "no"), "ticks_per_turn must be a positive number, not False"),
        (ROBOT.replace("4096", "many"), "ticks_per_turn must be a positive number, not many"),
        (ROBOT.replace("[0.098, 0.099]", "0.098"), "wheel_radius must be 2 positive numbers, not 0.098"),
        (ROBOT.replace("wheel_base", "# wheel_base"), "wheel_base is missing"),
        (ROBOT.replace("wheel_base", "whel_base"), "whel_base is unknown; did you mean wheel_base?"),
        (ROBOT + MOUNT.replace("quat_xyzw", "quat_xyz"), "T_base_camera.quat_xyz is unknown; did you mean T_base"),
        (ROBOT.replace("0.485", "on"), "wheel_base must be a positive number, not True"),
        (ROBOT.replace("0.099", "yes"), "wheel_radius must be 2 positive numbers, not [0.098, True]"),
        (ROBOT + "T_base_camera: 5", "T_base_camera is a group of values, not one: xyz, quat_xyzw"),
        (ROBOT.replace("0.485", "-0.485"), "wheel_base must be a positive number, not -0.485"),
        (ROBOT.replace("0.485", ".nan"), "wheel_base must be a positive number, not nan"),
        (ROBOT.replace("4096", "9" * 310), "ticks_per_turn must be a positive number, not 999"),  # no float is so large
        (ROBOT.replace("0.099", "9" * 310), "wheel_radius must be 2 positive numbers, not [0.098, 999"),
        (ROBOT.replace("0.098", "98"), "wheel_radius has 98 m, no robot is so large; it is given in metres"),
        (ROBOT.replace("0.485", "485"), "wheel_base has 485 m, no robot is so large; it is given in metres"),
        (ROBOT + MOUNT.replace("0.18", "-180"), "xyz of T_base_camera has -180 m, no robot is so large; it is given"),
        (ROBOT + MOUNT + "camera_time_offset: late", "camera_time_offset must be a number, not late"),
        (ROBOT, "T_base_camera must have xyz (3 numbers, metres) and quat_xyzw (4 numbers, not all zero)"),
        (ROBOT + MOUNT.replace("[0, 0, 1, 1]", "[0, 0, 0, 0]"), "T_base_camera must have xyz (3 numbers, metres)"),
        (
            ROBOT + MOUNT.replace("[0, 0, 1, 1]", "[1e-300, 0, 0, 1e-300]"),
            "T_base_camera must have xyz (3 numbers, met",
        ),
        (ROBOT + MOUNT.replace("[0, 0, 1, 1]", "[0, 0, 0, 9e-7]"), "T_base_camera must have xyz (3 numbers, metres)"),
    ],
)
def test_wrong_files_are_explained(tmp_path, text, complaint):
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'robot.yaml'}: {complaint}")) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'robot.yaml'}: cannot read the file: No such file")):
        read_robot_file(tmp_path / "robot.yaml")


def test_what_is_written_is_read_back(tmp_path):
    robot = read(tmp_path, ROBOT + MOUNT + "camera_time_offset: -1e-2")  # a text in YAML 1.1
    again = robot_from_values(robot_values(robot), "node")
    np.testing.assert_allclose(again.T_base_camera, robot.T_base_camera, atol=1e-15)
    assert (again.ticks_per_turn, again.wheel_radius_m, again.wheel_base_m) == (4096.0, (0.098, 0.099), 0.485)
    assert again.camera_time_offset_s == -0.01


def test_an_empty_mount_is_none(tmp_path):
    other = np.diag([1.0, -1.0, -1.0, 1.0])
    robot = read(tmp_path, ROBOT + "T_base_camera: ''", find_mount=lambda: other)
    np.testing.assert_array_equal(robot.T_base_camera, other)
