# SPDX-License-Identifier: BSD-3-Clause
"""Opens a recording of any kind."""

from pathlib import Path
from typing import Callable, Optional, Union

from ceiling_dso_ros.io.bag import BagRecording
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.realsense_bag import RealsenseRecording, realsense_topics
from ceiling_dso_ros.io.recording import Recording, TopicNames
from ceiling_dso_ros.io.tum_folder import TumFolderRecording
from ceiling_dso_ros.io.warning_log import ignore_warning


def open_recording(
    path: Union[str, Path],
    topics: TopicNames = TopicNames(),
    camera_file: Optional[Union[str, Path]] = None,
    robot_file: Optional[Union[str, Path]] = None,
    rectified: bool = False,
    warn: Callable[[str], None] = ignore_warning,
) -> Recording:
    """Open a folder in the TUM-mono layout or a ROS 1 bag, also one that realsense-viewer has recorded.

    Args:
        path: folder or bag.
        topics: topic names in a bag.
        camera_file: a `camera.txt` instead of the recording's own calibration.
        robot_file: a `robot.yaml` instead of the folder's own, or of the one beside the bag (`tour.robot.yaml`).
        rectified: the images of a bag are rectified: P of camera_info describes them, not K and D.
        warn: is given what is doubtful in the recording, one line each.

    Raises:
        InputError: there is no recording, or it cannot be used.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such folder or bag")
    if not path.is_dir() and not path.is_file():
        raise InputError(f"{path}: neither a folder nor a file; a pipe or a device cannot be read twice")
    camera_path = None if camera_file is None else Path(camera_file)
    robot_path = None if robot_file is None else Path(robot_file)
    if rectified and (path.is_dir() or camera_path is not None):
        raise InputError(
            f"{camera_path or path}: 'rectified' means P of camera_info; for rectified images, a camera.txt has the "
            "line 'Pinhole fx fy cx cy 0'"
        )
    if path.is_dir():
        return TumFolderRecording(path, camera_path, robot_path)
    of_realsense = realsense_topics(path, topics)
    if of_realsense is not None:
        return RealsenseRecording(path, of_realsense, camera_path, robot_path, rectified, warn)
    return BagRecording(path, topics, camera_path, robot_path, rectified, warn)
