# SPDX-License-Identifier: BSD-3-Clause
"""Keeps a node's trajectories on the disk, and writes them where they are wanted."""

import os
import threading
from pathlib import Path
from typing import Callable, Generic, Mapping, Optional, Protocol, Set, TypeVar

import rospy

from ceiling_dso_ros.io.errors import InputError, OutputError, one_line, reason_of
from ceiling_dso_ros.playback.spool import MEGABYTE, Spool, SpoolFolder
from ceiling_dso_ros.playback.spool_files import Written, set_aside, write_all, write_all_apart
from ceiling_dso_ros.ros import parameters
from ceiling_dso_ros.ros.periodic import Periodic
from ceiling_dso_ros.srv import SaveTrajectory, SaveTrajectoryRequest, SaveTrajectoryResponse

COLLECT = "python3 -m ceiling_dso_ros collect {} --out DIR writes them; then remove the folder"
FLUSH_PERIOD_S = 1.0  # what is lost when the node is killed

AnySpool = TypeVar("AnySpool", bound=Spool)


class KeepingParameters(Protocol):
    """Those of the parameters of a node that say what is kept."""

    @property
    def keep_trajectory(self) -> bool:
        """Whether anything is kept."""

    @property
    def trajectory_limit_mb(self) -> int:
        """Largest size on the disk, megabytes."""

    @property
    def trajectory_dir(self) -> str:
        """Folder for the trajectories of the whole run; none for the empty text."""


class TrajectoryKeeper(Generic[AnySpool]):
    """Keeps results while the node runs, and makes trajectories of them.

    They are in a folder of their own in ~trajectory_dir, or else in ceiling_dso_ros in ROS_HOME. A disk that does not
    take them does not stop the node.

    Attributes:
        spool: takes the results; None where nothing is kept.
    """

    def __init__(
        self,
        own: KeepingParameters,
        begin: Callable[[SpoolFolder, int], AnySpool],
        newest: Callable[[AnySpool], Mapping[str, bytes]],
    ) -> None:
        """Begin.

        Args:
            own: parameters of the node.
            begin: makes the spool, given its folder and the largest size of its files in bytes.
            newest: gives the results that are not final yet, as `Spool.beside` takes them.

        Raises:
            InputError: ~trajectory_dir cannot be written to.
        """
        self._newest = newest
        self._directory = parameters.output_folder(own.trajectory_dir)
        self._saving = threading.Lock()
        self._failure = ""
        self._told: Set[str] = set()  # complaints that were logged
        self.spool = self._begin(begin, own.trajectory_limit_mb * MEGABYTE) if own.keep_trajectory else None
        if self.spool is not None:
            Periodic(self._flush, FLUSH_PERIOD_S, "writing of trajectories")

    def offer_service(self) -> None:
        """Offer ~save_trajectory; `newest` may be asked from now on."""
        rospy.Service("~save_trajectory", SaveTrajectory, self._answer)

    @property
    def complaint(self) -> str:
        """Why results are not kept though they should be, in words; empty when they are."""
        return self._failure if self.spool is None else self.spool.complaint

    @property
    def lost(self) -> int:
        """Number of results that the disk did not take."""
        return 0 if self.spool is None else self.spool.lost

    def clear(self) -> None:
        """A new run begins; the results of the one before stay in a folder of their own."""
        if self.spool is not None:
            self.spool.clear()

    def end(self) -> None:
        """End of the node: write the trajectories to ~trajectory_dir, if it is given, and remove what was kept.

        Raises:
            OutputError: a file cannot be written, or nothing was kept; what was kept stays.
        """
        if self._directory is not None:
            try:  # here, because no output is waited for any more, and another process would take a second to start
                earlier = None if self.spool is None else set_aside(self.spool.path, self._directory)
                if earlier is not None:
                    print(f"{self._directory}: trajectories of an earlier run are in {earlier} now")
                print(self._save(self._directory, write_all))
            except (InputError, OutputError) as error:
                kept = "" if self.spool is None else f"; what was kept stays in {self.spool.path}"
                raise OutputError(f"{error}{kept}") from error
        if self.spool is not None:
            self.spool.remove()

    def _flush(self) -> None:
        """Bring results to the disk; each kind of complaint is logged once, the diagnostics have all."""
        if self.spool is None:
            return
        self.spool.flush()
        if self.spool.left is not None:
            rospy.logwarn(f"the run before has left its trajectories: {COLLECT.format(self.spool.left)}")
            _tell_given_up(self.spool.folder)
        complaint = self.spool.complaint
        if complaint and complaint not in self._told:
            self._told.add(complaint)
            rospy.logwarn(complaint)

    def _save(self, directory: Path, write: Callable[[Path, Path], Written]) -> str:
        """Write the trajectories so far; returns what was written. Results are added all the while.

        Args:
            directory: to write to.
            write: makes the files of what is kept.

        Raises:
            InputError: nothing is kept, or the folder cannot be made or written to.
            OutputError: a file cannot be written; the others are.
        """
        if self.spool is None:
            raise InputError(f"{rospy.get_name()}: no trajectories: {self._failure or 'keep_trajectory is false'}")
        parameters.make_writable(directory)
        with self._saving:
            newest = self._newest(self.spool)
            with self.spool.at_rest(), self.spool.beside(newest):
                written = write(self.spool.path, directory)
        if written.errors:
            raise OutputError(f"{'; '.join(written.errors)}; written: {written if written.poses else 'nothing'}")
        return f"{directory.resolve()}: {written}"

    def _begin(self, begin: Callable[[SpoolFolder, int], AnySpool], limit: int) -> Optional[AnySpool]:
        base = self._directory or Path(os.environ.get("ROS_HOME") or Path.home() / ".ros") / "ceiling_dso_ros"
        try:
            folder = SpoolFolder(base, rospy.get_name().strip("/").replace("/", "-"), limit)
            spool = begin(folder, limit)
        except OSError as error:
            self._failure = f"{base}: trajectories cannot be kept: {reason_of(error)}"
            rospy.logwarn(self._failure)
            return None
        for left in folder.left_over:
            rospy.logwarn(f"a run that was killed has left its trajectories: {COLLECT.format(left)}")
        _tell_given_up(folder)
        return spool

    def _answer(self, request: SaveTrajectoryRequest) -> SaveTrajectoryResponse:
        try:
            directory = parameters.file_path(request.directory)
            if directory is None:
                raise InputError("directory is empty: name the folder to write to")
            return SaveTrajectoryResponse(True, one_line(self._save(directory, write_all_apart)))
        except (InputError, OutputError) as error:
            return SaveTrajectoryResponse(False, one_line(str(error)))


def _tell_given_up(folder: SpoolFolder) -> None:
    for path in folder.given_up:
        rospy.logwarn(f"{path}: was removed: earlier runs have left more than trajectory_limit_mb")
