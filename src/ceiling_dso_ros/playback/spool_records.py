# SPDX-License-Identifier: BSD-3-Clause
"""Reads what nodes have kept on the disk. After a loss of power, parts of such files may be zeros or anything else."""

import re
from pathlib import Path
from typing import Callable, Iterator

import numpy as np

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.limits import LARGEST_M
from ceiling_dso_ros.io.rolling_file import read_rolling
from ceiling_dso_ros.io.stamps import LATEST_NS

NUMBER = rb"\d{1,10}(?:\.\d+)?"
POSE_LINES = re.compile(rb"(?:" + NUMBER + rb"(?: -?" + NUMBER + rb"){7}\n)*")

Tell = Callable[[str], None]


def read_records(
    path: Path, kind: np.dtype, is_sound: Callable[[np.ndarray], np.ndarray], tell: Tell
) -> Iterator[np.ndarray]:
    """The sound records of a rolling file, in pieces, each (N,) of a dtype.

    Args:
        path: the file; there may be none.
        kind: of a record; it has a field `stamp_ns`.
        is_sound: from (M,) records to (M,) bool.
        tell: is told in one line how many are left out.

    Raises:
        InputError: it cannot be read, or none of its records is sound.
    """
    count = kept = 0
    for piece in read_rolling(path, kind.itemsize):
        records = np.frombuffer(piece, kind)
        has_stamp = (records["stamp_ns"] >= 0) & (records["stamp_ns"] < LATEST_NS)
        sound = records[has_stamp & is_sound(records)]
        count += len(records)
        kept += len(sound)
        yield sound
    if count and not kept:
        raise InputError(f"{path}: is damaged: none of its {count} records can be used")
    if kept < count:
        tell(f"{path}: {count - kept} of its {count} records are damaged and left out")


def are_poses(T: np.ndarray) -> np.ndarray:
    """Which of (N, 3, 4) are rigid motions, (N,) bool."""
    is_finite = np.isfinite(T).all(axis=(1, 2)) & (np.abs(T).max(axis=(1, 2), initial=0.0) < LARGEST_M)
    R = np.where(is_finite[:, None, None], T[:, :, :3], 0.0)
    is_rotation = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0) < 1e-3
    # A triple product: np.linalg.det warns of overflows with some damaged records.
    is_right_handed = np.einsum("ni,ni->n", np.cross(R[:, 0], R[:, 1]), R[:, 2]) > 0.0
    return is_finite & is_rotation & is_right_handed


def are_numbers(records: np.ndarray, *names: str) -> np.ndarray:
    """In which of (N,) records these fields have numbers that are finite and not beyond all bounds, (N,) bool."""
    sound = np.ones(len(records), bool)
    for name in names:
        limit = LARGEST_M**2 if "covariance" in name else LARGEST_M
        sound &= (np.abs(records[name].reshape(len(records), -1)) < limit).all(axis=1)  # NaN is not
    return sound


def read_pose_lines(path: Path, tell: Tell) -> Iterator[bytes]:
    """The lines of a rolling file with a trajectory, in pieces; what is no pose is left out, and told as above."""
    count = damaged = 0
    for piece in read_rolling(path):
        count += piece.count(b"\n")
        if POSE_LINES.fullmatch(piece):
            yield piece
            continue
        lines = piece.splitlines(keepends=True)
        sound = [line for line in lines if POSE_LINES.fullmatch(line)]
        damaged += len(lines) - len(sound)
        yield b"".join(sound)
    if damaged:
        tell(f"{path}: {damaged} of its {count} lines are damaged and left out")
