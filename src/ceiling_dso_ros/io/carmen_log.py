# SPDX-License-Identifier: BSD-3-Clause
"""Logs of CARMEN, in which the public recordings of 2D LiDARs are: `.log` or `.clf`, also with gzip.

Lines that are read: `FLASER n r1 ... rn x y theta odom_x odom_y odom_theta stamp host stamp`, where the rays cover 180
degrees from -90 degrees; `ROBOTLASER1 type start field_of_view resolution largest accuracy remission n r1 ... rn m ...
x y theta odom_x odom_y odom_theta tv rv safety side turn stamp host stamp`; `PARAM robot_front_laser_max`. Metres and
radians. x y theta is the laser's pose, corrected by who published the log.
"""

import gzip
import zlib
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.errors import InputError, reason_of
from ceiling_dso_ros.io.laser_scans import LaserScans, ScanCollector, ScanGeometry
from ceiling_dso_ros.io.limits import LARGEST_M, LONGEST_SCAN_LINE, MOST_RAYS, MOST_TABLE_BYTES
from ceiling_dso_ros.io.recording import WheelSamples, WheelUnit
from ceiling_dso_ros.io.stamps import NANOSECONDS, parse_stamp

ENDINGS = (".log", ".clf", ".log.gz", ".clf.gz")
LARGEST_RANGE_M = 80.0  # SICK's scanners say 81.83 or more where there is no return
FIELD_RAD = np.pi  # of the rays of FLASER
ROBOTLASER_HEAD = 8  # words between its name and the ranges


@dataclass(frozen=True)
class CarmenLog:
    """What a log contains.

    Attributes:
        scans: the scans; the laser is where the robot is.
        corrected: (N, 3) x, y, yaw of the laser at each scan, as they are in the log.
        odometry: x, y, yaw of the robot at each scan.
    """

    scans: LaserScans
    corrected: np.ndarray
    odometry: WheelSamples


def is_carmen_log(path: Path) -> bool:
    """Whether a file has the name of such a log."""
    return path.name.lower().endswith(ENDINGS)


def read_carmen_log(path: Path, warn: Callable[[str], None]) -> CarmenLog:
    """Read a log.

    Args:
        path: of the log.
        warn: is told what is not used.

    Raises:
        InputError: the file cannot be read, or has no scans that can be used.
    """
    collector = ScanCollector(str(path), warn)
    poses: Dict[int, np.ndarray] = {}
    largest_m = LARGEST_RANGE_M
    for text in _lines(path):
        kind, *words = text.split()
        if kind == "PARAM" and words[:1] == ["robot_front_laser_max"]:
            largest_m = min(largest_m, _number(words[1:2], largest_m))
        if kind not in ("FLASER", "ROBOTLASER1"):
            continue
        try:
            stamp_ns, ranges_m, geometry, pose = (_flaser if kind == "FLASER" else _robotlaser)(words)
        except (ValueError, IndexError):
            collector.unused[f"the line is not one of {kind}"] += 1
            continue
        collector.add(stamp_ns, ranges_m, geometry, np.array([0.0, largest_m]))
        poses.setdefault(stamp_ns, pose)
    scans = collector.scans(np.eye(4))
    kept = np.array([poses[stamp_ns] for stamp_ns in scans.stamps_ns.tolist()])
    odometry = WheelSamples(WheelUnit.POSES, scans.stamps_ns, kept[:, 3:], f"{path}, the odometry of its scans")
    return CarmenLog(scans, kept[:, :3], odometry)


def _lines(path: Path) -> Iterator[str]:
    size, is_packed = 0, path.name.lower().endswith(".gz")
    try:
        with path.open("rb") as raw, gzip.GzipFile(fileobj=raw) if is_packed else raw as file:
            line = file.readline(LONGEST_SCAN_LINE + 1)
            while line:
                size += len(line)
                if len(line) > LONGEST_SCAN_LINE:
                    raise InputError(f"{path}: a line has more than {LONGEST_SCAN_LINE} bytes: it is no log of CARMEN")
                if size > MOST_TABLE_BYTES:
                    raise InputError(f"{path}: has more than {MOST_TABLE_BYTES} bytes; split it")
                text = line.decode("utf-8", errors="replace").strip()
                if text and not text.startswith("#"):
                    yield text
                line = file.readline(LONGEST_SCAN_LINE + 1)
    except (OSError, EOFError, zlib.error) as error:  # gzip raises all three
        reason = reason_of(error) if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: cannot read the log: {reason}") from error


def _flaser(words: Sequence[str]) -> Tuple[int, np.ndarray, ScanGeometry, np.ndarray]:
    count = _count(words[0])
    ranges = _numbers(words[1 : count + 1], count)
    # 180 rays are one in each degree from the first on, 181 have one at each end
    increment = FIELD_RAD / (count - 1 if count % 2 else count)
    rest = words[count + 1 :]
    return _stamp_ns(rest[6]), ranges, ScanGeometry(-FIELD_RAD / 2, increment, 0.0), _poses(rest)


def _robotlaser(words: Sequence[str]) -> Tuple[int, np.ndarray, ScanGeometry, np.ndarray]:
    count = _count(words[ROBOTLASER_HEAD - 1])
    start, _, increment = _numbers(words[1:4], 3)
    ranges = _numbers(words[ROBOTLASER_HEAD : ROBOTLASER_HEAD + count], count)
    rest = words[ROBOTLASER_HEAD + count :]
    rest = rest[1 + int(rest[0]) :]  # remissions
    return _stamp_ns(rest[11]), ranges, ScanGeometry(start, increment, 0.0), _poses(rest)


def _count(word: str) -> int:
    count = int(word)
    if not 2 <= count <= MOST_RAYS:
        raise ValueError(f"{count} rays")
    return count


def _numbers(words: Sequence[str], count: int) -> np.ndarray:
    numbers = np.array([float(word) for word in words])
    if len(numbers) != count:
        raise ValueError(f"{len(numbers)} instead of {count} numbers")
    return numbers


def _poses(words: Sequence[str]) -> np.ndarray:
    """(6,) of the laser and of the odometry."""
    poses = _numbers(words[:6], 6)
    if not np.abs(poses).max() < LARGEST_M:
        raise ValueError("a pose is not finite, or beyond all bounds")
    return poses


def _stamp_ns(word: str) -> int:
    """Seconds; those of simulated logs may be small."""
    return int((parse_stamp(word) * Decimal(NANOSECONDS)).to_integral_value())


def _number(words: List[str], otherwise: float) -> float:
    try:
        number = float(words[0])
    except (ValueError, IndexError):
        return otherwise
    return number if 0.0 < number < np.inf else otherwise
