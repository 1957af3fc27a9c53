# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories in the TUM format: a line `stamp tx ty tz qx qy qz qw` for every pose."""

import re
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Callable, List, Optional, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.stamps import NANOSECONDS, format_stamp, longest_increasing, parse_stamp
from ceiling_dso_ros.io.text_files import increasing_stamps, read_lines, stamps_of_file
from ceiling_dso_ros.io.warning_log import CountedMessages

LINE = "%s" + 7 * " %.9f" + "\n"
QUOTED = re.compile(r"'[^']*'")  # what a line has instead of a number
Rows = List[Tuple[str, Decimal, List[float]]]  # where a line is, its stamp, its pose


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
            that is not finite, or a stamp that is not later than the one before.
    """
    path = Path(path)
    wrong = CountedMessages()
    rows = _parse_lines(path, None if warn is None else wrong)
    stamps = [stamp for _, stamp, _ in rows]
    if warn is None:
        stamps_ns = increasing_stamps(path, [(where, stamp) for where, stamp, _ in rows])
    else:
        stamps_ns = stamps_of_file(path, stamps)
        kept = longest_increasing(stamps_ns)
        _count_left_out(rows, stamps_ns, kept, wrong)
        rows, stamps_ns = [rows[index] for index in kept], [stamps_ns[index] for index in kept]
        for text, count in wrong.first_and_counts():
            warn(f"{text}; left out" + (f", as are {count - 1} more such lines" if count > 1 else ""))
    table = np.array([pose for _, _, pose in rows])
    quaternions = table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True)
    return Trajectory(np.array(stamps_ns, np.int64), table[:, :3], quaternions)


def _parse_lines(path: Path, wrong: Optional[CountedMessages]) -> Rows:
    """The lines with a pose; what is wrong with others is counted, or raised where there is nothing to count it in."""
    rows: Rows = []
    first_error: Optional[InputError] = None
    for where, line in read_lines(path):
        try:
            rows.append((where, *_parse_line(line, where)))
        except InputError as error:
            if wrong is None:
                raise
            first_error = first_error or error
            wrong.add(str(error), QUOTED.sub("", str(error)))
    if not rows:
        raise first_error or InputError(f"{path}: no poses in it; expected lines of 'stamp tx ty tz qx qy qz qw'")
    return rows


def _count_left_out(rows: Rows, stamps_ns: List[int], kept: List[int], wrong: CountedMessages) -> None:
    known = {stamps_ns[index] for index in kept}
    for index in sorted({*range(len(rows))} - {*kept}):
        repeated = stamps_ns[index] in known
        wrong.add(f"{rows[index][0]}: the stamp {'is that of another line' if repeated else 'is out of order'}")


def _parse_line(line: str, where: str) -> Tuple[Decimal, List[float]]:
    try:
        stamp, *numbers = line.replace(",", " ").split()
        number, pose = parse_stamp(stamp), [float(word) for word in numbers]
    except ValueError as error:
        raise InputError(f"{where}: {error}; expected 'stamp tx ty tz qx qy qz qw'") from error
    if len(pose) != 7:
        raise InputError(f"{where}: {len(pose) + 1} numbers instead of 8: stamp tx ty tz qx qy qz qw")
    if not np.isfinite(pose).all():
        raise InputError(f"{where}: a number is not finite")
    if np.linalg.norm(pose[3:]) < 1e-6:
        raise InputError(f"{where}: the quaternion is zero")
    return number, pose


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
