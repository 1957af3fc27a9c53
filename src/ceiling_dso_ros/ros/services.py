# SPDX-License-Identifier: BSD-3-Clause
"""Services; a response contains a message that says what is wrong with a request."""

from pathlib import Path
from typing import Callable, Dict

import rospy
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from ceiling_dso_ros.io.errors import InputError, OutputError
from ceiling_dso_ros.io.trajectory import Trajectory, write_tum
from ceiling_dso_ros.ros.parameters import make_writable
from ceiling_dso_ros.srv import SaveTrajectory, SaveTrajectoryRequest, SaveTrajectoryResponse


def offer_trigger(name: str, act: Callable[[], str]) -> None:
    """Offer a service without arguments; act returns a message about what it did."""

    def answer(_request: TriggerRequest) -> TriggerResponse:
        message = act()
        rospy.loginfo(message)
        return TriggerResponse(True, message)

    rospy.Service(name, Trigger, answer)


def offer_save_trajectory(trajectories: Callable[[], Dict[str, Trajectory]]) -> None:
    """Offer ~save_trajectory; trajectories are by the names of their files, without `.tum`."""

    def answer(request: SaveTrajectoryRequest) -> SaveTrajectoryResponse:
        try:
            return SaveTrajectoryResponse(True, save(Path(request.directory).expanduser(), trajectories()))
        except (InputError, OutputError) as error:
            return SaveTrajectoryResponse(False, str(error))

    rospy.Service("~save_trajectory", SaveTrajectory, answer)


def save(directory: Path, trajectories: Dict[str, Trajectory]) -> str:
    """Write the files; returns what was written.

    Raises:
        InputError: the folder cannot be made or written to.
        OutputError: a file cannot be written.
    """
    make_writable(directory)
    for name, trajectory in trajectories.items():
        write_tum(directory / f"{name}.tum", trajectory)
    counts = ", ".join(f"{name}.tum ({len(trajectory)} poses)" for name, trajectory in trajectories.items())
    return f"{directory.resolve()}: {counts}"
