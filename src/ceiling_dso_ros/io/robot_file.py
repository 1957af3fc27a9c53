"""Reads `robot.yaml`, the dimensions of a robot."""

from pathlib import Path
from typing import Any, Optional, Sequence

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.recording import RobotDescription


def read_robot_file(path: Path, T_base_camera: Optional[np.ndarray] = None) -> RobotDescription:
    """Read a robot's dimensions.

    They are ticks_per_turn, wheel_radius [left, right] and wheel_base in metres, T_base_camera {xyz, quat_xyzw}, and
    optionally camera_time_offset in seconds.

    Args:
        path: the yaml file.
        T_base_camera: (4, 4), for a file that does not have it.

    Raises:
        InputError: the file cannot be read, or a value is missing or impossible.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not yaml: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected the keys ticks_per_turn, wheel_radius, wheel_base, T_base_camera")

    (ticks_per_turn,) = _positive_numbers(content, "ticks_per_turn", 1, path)
    left_m, right_m = _positive_numbers(content, "wheel_radius", 2, path)
    (wheel_base_m,) = _positive_numbers(content, "wheel_base", 1, path)
    if "T_base_camera" in content or T_base_camera is None:
        T_base_camera = _transform(content.get("T_base_camera"), path)
    offset_s = _numbers(content.get("camera_time_offset", 0.0), 1)
    if offset_s is None:
        raise InputError(f"{path}: camera_time_offset must be a number, not {content['camera_time_offset']}")
    return RobotDescription(ticks_per_turn, (left_m, right_m), wheel_base_m, T_base_camera, *offset_s)


def _positive_numbers(content: dict, key: str, count: int, path: Path) -> Sequence[float]:
    numbers = _numbers(content.get(key), count)
    if numbers is None or min(numbers) <= 0:
        expected = "a positive number" if count == 1 else f"{count} positive numbers"
        raise InputError(f"{path}: {key} must be {expected}, not {content.get(key)}")
    return numbers


def _transform(value: Any, path: Path) -> np.ndarray:  # noqa: ANN401
    value = value if isinstance(value, dict) else {}
    translation, quaternion = _numbers(value.get("xyz"), 3), _numbers(value.get("quat_xyzw"), 4)
    if translation is None or quaternion is None or not any(quaternion):
        raise InputError(f"{path}: T_base_camera must have xyz (3 numbers, metres) and quat_xyzw (4 numbers)")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    T[:3, 3] = translation
    return T


def _numbers(value: Any, count: int) -> Optional[Sequence[float]]:  # noqa: ANN401
    """Value as that many finite numbers, None if it is something else."""
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        return None
    return tuple(numbers.tolist()) if numbers.shape == (count,) and np.isfinite(numbers).all() else None
