# SPDX-License-Identifier: BSD-3-Clause
"""Covariances of planar poses in a text file: a line `stamp xx xy xyaw yy yyaw yawyaw` for every pose.

Square metres, metre radians and square radians, in the frame of the poses.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import List

import numpy as np

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.stamps import format_stamp, parse_stamp
from ceiling_dso_ros.io.text_files import increasing_stamps, place_of_line, read_table

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
HEAD = "# stamp xx xy xyaw yy yyaw yawyaw, of x, y in metres and yaw in radians\n"
ROUNDING = 1e-9  # of an eigenvalue relative to the largest: numbers in a file are rounded


@dataclass(frozen=True)
class PoseCovariances:
    """How sure the poses of a trajectory are.

    Attributes:
        stamps_ns: (N,) int64 nanoseconds, increasing.
        matrices: (N, 3, 3) of x, y, yaw.
    """

    stamps_ns: np.ndarray
    matrices: np.ndarray


def covariances_path(trajectory: Path) -> Path:
    """Where the covariances of a trajectory are: reference.covariance.txt beside reference.tum."""
    return trajectory.with_name(f"{trajectory.stem}.covariance.txt")


def write_covariances(path: Path, covariances: PoseCovariances) -> None:
    """Write the file; an older one is replaced only when the new one is complete.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = [[matrix[i][j] for i, j in UPPER] for matrix in covariances.matrices.tolist()]
    lines = (
        " ".join([format_stamp(stamp_ns), *(f"{value:.9e}" for value in row)]) + "\n"
        for stamp_ns, row in zip(covariances.stamps_ns.tolist(), rows)
    )
    replace_file(path, (HEAD + "".join(lines)).encode(), "the covariances")


def read_covariances(path: Path) -> PoseCovariances:
    """Read the file.

    Raises:
        InputError: unreadable file, a line of another form, or a matrix that is no covariance.
    """
    numbers: List[int] = []
    stamps, rows = [], []
    for number, text in read_table(path):
        try:
            stamp, *values = text.split()
            stamps.append(parse_stamp(stamp))
            rows.append([float(value) for value in values])
        except ValueError as error:
            raise InputError(f"{place_of_line(path, number)}: {error}") from error
        numbers.append(number)
        if len(rows[-1]) != len(UPPER) or not all(map(math.isfinite, rows[-1])):
            raise InputError(
                f"{place_of_line(path, number)}: expected a stamp and six finite numbers: xx xy xyaw yy yyaw yawyaw"
            )
    if not rows:
        raise InputError(f"{path}: no covariances in it; expected lines of 'stamp xx xy xyaw yy yyaw yawyaw'")
    matrices = np.empty((len(rows), 3, 3))
    for (i, j), column in zip(UPPER, np.array(rows).T):
        matrices[:, i, j] = matrices[:, j, i] = column
    eigenvalues = np.linalg.eigvalsh(matrices)
    wrong = np.flatnonzero((eigenvalues[:, 0] < -ROUNDING * eigenvalues[:, 2]) | (eigenvalues[:, 2] <= 0.0))
    if len(wrong):
        raise InputError(f"{place_of_line(path, numbers[wrong[0]])}: the matrix is no covariance: it is not positive")
    return PoseCovariances(np.array(increasing_stamps(path, numbers, stamps), np.int64), matrices)
