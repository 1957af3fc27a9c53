# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories in the TUM format: a line `stamp tx ty tz qx qy qz qw` for every pose."""

import math
import re
from array import array
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Callable, List, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.limits import LARGEST_M
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.stamps import NANOSECONDS, format_stamp, longest_increasing, parse_stamp
from ceiling_dso_ros.io.text_files import increasing_stamps, place_of_line, read_table, stamps_of_file
from ceiling_dso_ros.io.warning_log import CountedMessages

LINE = "%s" + 7 * " %.9f" + "\n"
QUOTED = re.compile(r"'[^']*'")  # what a line has instead of a number


@dataclass(frozen=True)
class Trajectory:
    """Poses of one body in one frame over time.

    Attributes:
        stamps_ns: (N,) int64 nanoseconds, increasing.
        positions: (N, 3) float64.
        quaternions_xyzw: (N, 4) float64 of unit length.
    """

    stamps_ns: np.ndarray
    positions: np.ndarray
    quaternions_xyzw: np.ndarray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def times_s(self) -> np.ndarray:
        """(N,) float64 seconds since the first pose."""
        return (self.stamps_ns - self.stamps_ns[:1]) / NANOSECONDS

    def shifted(self, offset_ns: int) -> "Trajectory":
        """The same with nanoseconds added to all stamps."""
        return replace(self, stamps_ns=self.stamps_ns + offset_ns)

    @classmethod
    def from_matrices(cls, stamps_ns: ArrayLike, T_frame_body: ArrayLike) -> "Trajectory":
        """Trajectory of (N,) stamps and (N, 4, 4) poses."""
        T = np.asarray(T_frame_body, dtype=np.float64).reshape(-1, 4, 4)
        quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat() if len(T) else np.zeros((0, 4))
        return cls(np.array(stamps_ns, dtype=np.int64), T[:, :3, 3].copy(), quaternions)  # copies: recorders go on

    def matrices(self) -> np.ndarray:
        """T_frame_body, (N, 4, 4) float64."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        if len(self):
            T[:, :3, :3] = Rotation.from_quat(self.quaternions_xyzw).as_matrix()
        T[:, :3, 3] = self.positions
        return T


def read_tum(path: Union[str, Path], warn: Optional[Callable[[str], None]] = None) -> Trajectory:
    """Read a TUM file; blank lines and lines that begin with # are skipped, quaternions are normalised.

    Stamps are seconds, or whole nanoseconds; see `stamps_in_ns`.

    Args:
        path: of the file.
        warn: is told which lines cannot be used, one text for each reason; they are left out. Without it, such a line
            is an error.

    Raises:
        InputError: unreadable or empty file, or no usable line. Without `warn` also a line of another form, a number
            that is not finite or too large, or a stamp that is not later than the one before.
    """
    path = Path(path)
    wrong = CountedMessages()
    numbers, stamps, table = _parse_lines(path, None if warn is None else wrong)
    if warn is None:
        stamps_ns = np.array(increasing_stamps(path, numbers, stamps), np.int64)
    else:
        stamps_ns = np.array(stamps_of_file(path, stamps), np.int64)
        kept = np.array(longest_increasing(stamps_ns.tolist()), np.intp)
        _count_left_out(path, numbers, stamps_ns, kept, wrong)
        stamps_ns, table = stamps_ns[kept], table[kept]
        for text, count in wrong.first_and_counts():
            warn(f"{text}; left out" + (f", as are {count - 1} more such lines" if count > 1 else ""))
    quaternions = table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True)
    return Trajectory(stamps_ns, table[:, :3], quaternions)


def _parse_lines(path: Path, wrong: Optional[CountedMessages]) -> Tuple[Sequence[int], List[Decimal], np.ndarray]:
    """Numbers, stamps and (N, 7) poses of the lines that have one.

    What is wrong with others is counted, or raised where there is nothing to count it in.
    """
    numbers, poses = array("q"), array("d")  # compact: there may be millions of lines
    stamps: List[Decimal] = []
    first_error: Optional[InputError] = None
    for number, text in read_table(path):
        try:
            stamp, pose = _parse_line(text, path, number)
        except InputError as error:
            if wrong is None:
                raise
            first_error = first_error or error
            wrong.add(str(error), QUOTED.sub("", str(error)))
        else:
            numbers.append(number)
            stamps.append(stamp)
            poses.extend(pose)
    if not stamps:
        raise first_error or InputError(f"{path}: no poses in it; expected lines of 'stamp tx ty tz qx qy qz qw'")
    return numbers, stamps, np.array(poses).reshape(-1, 7)


def _count_left_out(
    path: Path, numbers: Sequence[int], stamps_ns: np.ndarray, kept: np.ndarray, wrong: CountedMessages
) -> None:
    known = set(stamps_ns[kept].tolist())
    for index in np.setdiff1d(np.arange(len(stamps_ns)), kept):
        what = "is that of another line" if int(stamps_ns[index]) in known else "is out of order"
        wrong.add(f"{place_of_line(path, numbers[index])}: the stamp {what}")


def _parse_line(line: str, path: Path, number: int) -> Tuple[Decimal, List[float]]:
    try:
        stamp_text, *words = line.replace(",", " ").split()
        stamp, pose = parse_stamp(stamp_text), [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{place_of_line(path, number)}: {error}; expected 'stamp tx ty tz qx qy qz qw'") from error
    problem = ""
    if len(pose) != 7:
        problem = f"{len(pose) + 1} numbers instead of 8: stamp tx ty tz qx qy qz qw"
    elif not all(map(math.isfinite, pose)):
        problem = "a number is not finite"
    elif max(map(abs, pose)) > LARGEST_M:
        problem = f"a number is beyond {LARGEST_M:g}"
    elif math.hypot(*pose[3:]) < 1e-6:
        problem = "the quaternion is zero"
    if problem:
        raise InputError(f"{place_of_line(path, number)}: {problem}")
    return stamp, pose


def write_tum(path: Union[str, Path], trajectory: Trajectory) -> None:
    """Write a TUM file; an older one is replaced only when the new one is complete.

    Raises:
        OutputError: the file cannot be written.
    """
    replace_file(path, tum_lines(trajectory), "the trajectory")


def tum_lines(trajectory: Trajectory) -> bytes:
    """The lines of a TUM file."""
    stamps = map(format_stamp, trajectory.stamps_ns.tolist())
    poses = np.column_stack([trajectory.positions, trajectory.quaternions_xyzw]).tolist()
    return "".join(LINE % (stamp, *pose) for stamp, pose in zip(stamps, poses)).encode()
