# SPDX-License-Identifier: BSD-3-Clause
"""The folder in which a node keeps its results while it runs, so that they neither fill its memory nor end with it."""

import fcntl
import os
import re
import shutil
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, Optional, Tuple

from ceiling_dso_ros.io.errors import OutputError, reason_of
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.rolling_file import RollingFile

MEGABYTE = 10**6
LOCK = "lock"
KEPT_BY_ALL = ".yaml"  # settings, which later runs of the same node have, too


class SpoolFolder:
    """A folder of one run of a node: BASE/NAME.<time>.<process>.spool.

    It is removed at the end of the run. One that stays is of a run that was killed. These are kept, the newest first,
    as far as their size together allows: a node that is killed again and again does not fill the disk.

    Attributes:
        path: the folder.
        left_over: folders of runs of this name that were killed, the newest first.
        given_up: those that were removed by the last change, because all together were too large.
    """

    def __init__(self, base: Path, name: str, left_over_limit: int = 1000 * MEGABYTE) -> None:
        """Make the folder, and remove old ones.

        Args:
            base: folder of the folders of all runs.
            name: of the node.
            left_over_limit: bytes that earlier runs may have left; the newest of them is kept in any case.

        Raises:
            OSError: it cannot be made.
        """
        base.mkdir(parents=True, exist_ok=True)
        self._base, self._name, self._limit = base, name, left_over_limit
        self.left_over, self.given_up = _keep_newest(base, name, left_over_limit)
        self.path = self._new_folder()
        self._lock = (self.path / LOCK).open("w")
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def leave_results(self) -> Optional[Path]:
        """Another run begins: leave the results so far in a folder of their own, as a run does that is killed.

        Returns:
            The folder; None if there are no results.

        Raises:
            OSError: the disk does not take it.
        """
        if not _has_results(self.path):
            return None
        left = self._new_folder()
        for path in self.path.iterdir():
            if path.name.endswith(KEPT_BY_ALL):
                shutil.copy(path, left)
            elif path.name != LOCK:
                path.rename(left / path.name)
        self.left_over, self.given_up = _keep_newest(self._base, self._name, self._limit)
        return left

    def _new_folder(self) -> Path:
        number = os.getpid()
        while True:
            path = self._base / f"{self._name}.{time.strftime('%Y%m%d-%H%M%S')}.{number}.spool"
            try:
                path.mkdir()
            except FileExistsError:  # of the same second
                number += 1
            else:
                return path

    def remove(self) -> None:
        """End of the run."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.close()


def _keep_newest(base: Path, name: str, limit: int) -> Tuple[List[Path], List[Path]]:
    """Remove folders without results, and the oldest beyond a size; returns what stays, and what was given up."""
    pattern = re.compile(rf"{re.escape(name)}\.\d+-\d+\.\d+\.spool")
    ended = [folder for folder in base.iterdir() if pattern.fullmatch(folder.name) and not _is_in_use(folder)]
    full = sorted((folder for folder in ended if _has_results(folder)), key=_age_key, reverse=True)
    sizes = [sum(path.stat().st_size for path in folder.iterdir()) for folder in full]
    kept = [folder for number, folder in enumerate(full) if number == 0 or sum(sizes[: number + 1]) <= limit]
    for folder in ended:
        if folder not in kept:
            shutil.rmtree(folder, ignore_errors=True)
    return kept, [folder for folder in full if folder not in kept]


def _is_in_use(folder: Path) -> bool:
    try:
        with (folder / LOCK).open("r+") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def _has_results(folder: Path) -> bool:
    return any(path.stat().st_size > 0 for path in folder.glob("*.tum"))


def _age_key(folder: Path) -> float:
    return max(path.stat().st_mtime for path in folder.glob("*.tum"))


class Spool:
    """Growing files in a folder. Results are added by the threads that compute them, and flushed by another one.

    Attributes:
        folder: of the run; path: where it is.
        complaint: why results were not kept by the last flush, in words; empty when they were.
        left: the folder in which the last flush has left the results of an earlier run; None if it has not.
    """

    def __init__(self, folder: SpoolFolder, limits: Mapping[str, int]) -> None:
        """Begin; limits: file name -> largest size in bytes, beyond which the oldest results are given up."""
        self.path = folder.path
        self.complaint = ""
        self.left: Optional[Path] = None
        self._another_run = False
        self.folder = folder
        self._files: Dict[str, RollingFile] = {n: RollingFile(self.path / n, limit) for n, limit in limits.items()}
        self._disk = threading.Lock()
        self._never_collected = 0  # results that were given up before they were in the form of the files
        self._lost_before = 0  # the last flush

    @property
    def lost(self) -> int:
        """Number of results that were given up since the begin because the disk did not take them."""
        return self._never_collected + sum(file.lost for file in self._files.values())

    def clear(self) -> None:
        """Another run begins: with the next flush, the results so far are left in a folder of their own."""
        self._another_run = True
        for file in self._files.values():
            file.clear()

    def flush(self) -> None:
        """Bring what was added to the disk. What a full disk does not take is lost, which is a complaint."""
        with self._disk:
            self._flush()

    @contextmanager
    def at_rest(self) -> Iterator[None]:
        """The files are complete, and do not change until the end of the block; results are added all the while."""
        with self._disk:
            self._flush()
            yield

    @contextmanager
    def beside(self, newest: Mapping[str, bytes]) -> Iterator[None]:
        """For the time of the block, further files are in the folder: results that are not final yet.

        Args:
            newest: name -> content. What cannot be written is left out, and stated in the complaint.
        """
        try:
            for name, content in newest.items():
                replace_file(self.path / name, content, "the newest results")
        except OutputError as error:
            self.complaint = str(error)
        try:
            yield
        finally:
            for name in newest:
                with suppress(OSError):
                    (self.path / name).unlink()

    def remove(self) -> None:
        """End: remove the folder."""
        with self._disk:
            for file in self._files.values():
                file.close()
            self.folder.remove()

    def _collect(self) -> None:
        """Append what is not yet in the form of the files."""

    def _flush(self) -> None:
        complaints: List[str] = []
        self.left = None
        if self._another_run:
            self._another_run = False
            try:
                self.left = self.folder.leave_results()
            except OSError as error:
                complaints.append(f"{self.path}: cannot keep the run before: {reason_of(error)}")
        self._collect()
        for file in self._files.values():
            try:
                file.flush()
            except OSError as error:
                complaints.append(f"{self.path}: cannot write: {reason_of(error)}")
        lost = self.lost
        if lost > self._lost_before and not complaints:
            complaints.append(f"{self.path}: the disk did not answer for too long: results were given up")
        self._lost_before = lost
        self.complaint = complaints[0] if complaints else ""
