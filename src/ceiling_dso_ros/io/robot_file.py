# SPDX-License-Identifier: BSD-3-Clause
"""Dimensions of a robot in `robot.yaml` and in the ROS parameters `~robot/...`."""

from pathlib import Path
from typing import Any, Callable, Dict, Mapping, Optional, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.known_names import require_known
from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.io.yaml_files import read_yaml

NAMES = {
    "ticks_per_turn": None,
    "wheel_radius": None,
    "wheel_base": None,
    "T_base_camera": {"xyz": None, "quat_xyzw": None},
    "camera_time_offset": None,
}

LARGEST_ROBOT_M = 20.0  # from its base to the camera, or from wheel to wheel


def read_robot_file(path: Path, find_mount: Optional[Callable[[], np.ndarray]] = None) -> RobotDescription:
    """Read a robot's dimensions; see `robot_from_values`.

    Args:
        path: the yaml file.
        find_mount: gives T_base_camera (4, 4), for a file that does not have it.

    Raises:
        InputError: the file cannot be read, or a value is missing, unknown or impossible.
    """
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected the keys ticks_per_turn, wheel_radius, wheel_base, T_base_camera")
    mount = None if find_mount is None or content.get("T_base_camera", "") != "" else find_mount()
    return robot_from_values(content, str(path), mount)


def robot_from_values(values: Mapping, source: str, T_base_camera: Optional[np.ndarray] = None) -> RobotDescription:
    """A robot's dimensions.

    Args:
        values: ticks_per_turn, wheel_radius [left, right] and wheel_base in metres, T_base_camera {xyz, quat_xyzw}, and
            optionally camera_time_offset in seconds.
        source: file or parameter of the values, for the message.
        T_base_camera: (4, 4), used if the values have none.

    Raises:
        InputError: a value is missing, unknown or impossible.
    """
    mount = values.get("T_base_camera", "")
    require_known({**values, "T_base_camera": {} if mount == "" else mount}, NAMES, source)
    (ticks_per_turn,) = _positive_numbers(values, "ticks_per_turn", 1, source)
    left_m, right_m = _positive_numbers(values, "wheel_radius", 2, source)
    (wheel_base_m,) = _positive_numbers(values, "wheel_base", 1, source)
    _require_metres((left_m, right_m), "wheel_radius", source)
    _require_metres((wheel_base_m,), "wheel_base", source)
    if mount != "" or T_base_camera is None:
        T_base_camera = rigid_motion(mount, "T_base_camera", source)
    offset_s = _numbers(values.get("camera_time_offset", 0.0), 1)
    if offset_s is None:
        raise InputError(f"{source}: camera_time_offset must be a number, not {values['camera_time_offset']}")
    return RobotDescription(ticks_per_turn, (left_m, right_m), wheel_base_m, T_base_camera, *offset_s)


def robot_values(robot: RobotDescription) -> Dict[str, Any]:
    """All dimensions as `robot_from_values` takes them, of types that yaml and the parameter server know."""
    T = robot.T_base_camera
    return {
        "ticks_per_turn": float(robot.ticks_per_turn),
        "wheel_radius": [float(radius_m) for radius_m in robot.wheel_radius_m],
        "wheel_base": float(robot.wheel_base_m),
        "T_base_camera": {"xyz": T[:3, 3].tolist(), "quat_xyzw": Rotation.from_matrix(T[:3, :3]).as_quat().tolist()},
        "camera_time_offset": float(robot.camera_time_offset_s),
    }


def _positive_numbers(values: Mapping, key: str, count: int, source: str) -> Sequence[float]:
    if key not in values:
        raise InputError(f"{source}: {key} is missing")
    numbers = _numbers(values[key], count)
    if numbers is None or min(numbers) <= 0:
        expected = "a positive number" if count == 1 else f"{count} positive numbers"
        raise InputError(f"{source}: {key} must be {expected}, not {values[key]}")
    return numbers


def _require_metres(lengths_m: Sequence[float], key: str, source: str) -> None:
    if max(map(abs, lengths_m)) > LARGEST_ROBOT_M:
        raise InputError(
            f"{source}: {key} has {max(lengths_m, key=abs):g} m, no robot is so large; it is given in metres"
        )


def rigid_motion(value: Any, name: str, source: str) -> np.ndarray:  # noqa: ANN401
    """(4, 4) of {xyz, quat_xyzw}, metres.

    Args:
        value: what a file or a parameter has.
        name, source: of it, for the message.

    Raises:
        InputError: it is none.
    """
    value = value if isinstance(value, dict) else {}
    translation, quaternion = _numbers(value.get("xyz"), 3), _numbers(value.get("quat_xyzw"), 4)
    if translation is None or quaternion is None or np.linalg.norm(quaternion) < 1e-6:
        raise InputError(f"{source}: {name} must have xyz (3 numbers, metres) and quat_xyzw (4 numbers, not all zero)")
    _require_metres(translation, f"xyz of {name}", source)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    T[:3, 3] = translation
    return T


def _numbers(value: Any, count: int) -> Optional[Sequence[float]]:  # noqa: ANN401
    """Value as that many finite numbers, None if it is something else; texts will do, as 1e-5 is one in yaml."""
    if any(isinstance(member, bool) for member in (value if isinstance(value, list) else [value])):  # yaml's on and off
        return None
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (OverflowError, TypeError, ValueError):
        return None
    return tuple(numbers.tolist()) if numbers.shape == (count,) and np.isfinite(numbers).all() else None
