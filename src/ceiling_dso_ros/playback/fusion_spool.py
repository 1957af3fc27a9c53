# SPDX-License-Identifier: BSD-3-Clause
"""What fusion_node keeps of a run on the disk, and the trajectories that are made of it."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, Dict, Iterable, Sequence

import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.fusion.motion import MOTION
from ceiling_dso_ros.fusion.smoothing import smooth
from ceiling_dso_ros.fusion.state import FusedState
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.trajectory import read_tum, tum_lines
from ceiling_dso_ros.io.warning_log import ignore_warning
from ceiling_dso_ros.playback.fused_record import FusedRecord, planar_trajectory, smoothed_trajectory
from ceiling_dso_ros.playback.spool import Spool, SpoolFolder
from ceiling_dso_ros.playback.spool_records import Tell, are_numbers, read_records
from ceiling_dso_ros.settings import load_settings, write_settings

SETTINGS = "fusion.yaml"
MOTIONS, NEWEST_MOTIONS, ORIGIN = "motions.bin", "motions.newest.bin", "origin.tum"
# An hour of wheels at 50 Hz and of five keyframes a second takes 20, 20 and 6 MB.
SHARES = {"wheel.tum": 0.43, "fused.tum": 0.43, MOTIONS: 0.14}
LEAST_SIGMA = 1e-9  # of the logarithm of a scale: a smaller one is damaged, and its information no number
MOST_OUTPUTS = 100_000  # that wait for a disk that does not answer, half an hour


class FusionSpool(Spool):
    """wheel.tum and fused.tum as they will be, and what the keyframes measured, MOTION, which smoothing starts from."""

    def __init__(self, folder: SpoolFolder, limit: int, config: FusionConfig) -> None:
        """Begin.

        Args:
            folder: for all files.
            limit: of their sizes together, bytes.
            config: of the fusion, which smoothing needs.

        Raises:
            OSError: the folder cannot be written to.
        """
        super().__init__(folder, {name: int(share * limit) for name, share in SHARES.items()})
        write_settings(self.path / SETTINGS, config)
        self._lock = threading.Lock()
        self._outputs = FusedRecord()
        self._run = 0

    def add(self, state: FusedState, wheel_pose: np.ndarray) -> None:
        """Keep an output, and the (3,) pose by the wheels alone."""
        with self._lock:
            if len(self._outputs) >= MOST_OUTPUTS:
                self._never_collected += len(self._outputs)
                self._outputs = FusedRecord()
            self._outputs.add(state, wheel_pose)

    def add_motions(self, motions: Iterable[np.ndarray]) -> None:
        """Keep what keyframes measured that are no longer refined, each MOTION."""
        for motion in motions:
            self._files[MOTIONS].append(motion.tobytes())

    @staticmethod
    def newest(motions: Sequence[np.ndarray], origin: np.ndarray) -> Dict[str, bytes]:
        """What is not final yet, for `beside`.

        Args:
            motions: of the keyframes that are still refined, each MOTION.
            origin: (3,) pose of the first wheel sample in odom.
        """
        return {
            NEWEST_MOTIONS: np.array(motions, MOTION).tobytes(),
            ORIGIN: tum_lines(planar_trajectory([0], origin[None])),
        }

    def clear(self) -> None:
        """See Spool."""
        with self._lock:
            self._run += 1
            self._outputs = FusedRecord()
            super().clear()

    def _collect(self) -> None:
        with self._lock:
            outputs, self._outputs, run = self._outputs, FusedRecord(), self._run
        wheel, fused = tum_lines(outputs.wheel()), tum_lines(outputs.fused())
        with self._lock:
            if run == self._run:
                self._files["wheel.tum"].append(wheel, len(outputs))
                self._files["fused.tum"].append(fused, len(outputs))


def write_smoothed(folder: Path, file: BinaryIO, tell: Tell) -> int:
    """Write the smoothed trajectory of what a FusionSpool has kept; returns the number of poses.

    Raises:
        InputError: the folder cannot be read, or what is in it is damaged.
    """
    motions = kept_motions(folder, tell)
    origin = np.zeros(3)
    if (folder / ORIGIN).exists():
        T = read_tum(folder / ORIGIN).matrices()[0]
        origin = np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])
    try:
        nodes = smooth(motions, load_settings(folder / SETTINGS, kind=FusionConfig))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InputError(f"{folder / MOTIONS}: is damaged: {error}") from error
    placed = [replace(node, pose=planar.compose(origin, node.pose)) for node in nodes]
    if not np.isfinite([node.pose for node in placed]).all():
        raise InputError(f"{folder / MOTIONS}: is damaged: it gives no finite poses")
    file.write(tum_lines(smoothed_trajectory(placed)))
    return len(placed)


def kept_motions(folder: Path, tell: Tell = ignore_warning) -> np.ndarray:
    """(N,) MOTION of consecutive keyframes: all, or the longest part without a gap where the disk was full for a while.

    Raises:
        InputError: the folder cannot be read.
    """
    motions, newest = (
        np.concatenate([np.zeros(0, MOTION), *read_records(folder / name, MOTION, _are_motions, tell)])
        for name in (MOTIONS, NEWEST_MOTIONS)
    )
    last = motions["end"][-1] if len(motions) else 0
    motions = np.concatenate([motions, newest[newest["end"] > last]])
    gaps = np.flatnonzero(motions["end"][1:] != motions["end"][:-1] + 1)
    return max(np.split(motions, gaps + 1), key=len)


def _are_motions(records: np.ndarray) -> np.ndarray:
    """Which of (N,) MOTION have numbers, (N,) bool."""
    always = ("start_pose", "wheels", "wheels_covariance", "by_constants", "walk_sigma", "log_scale")
    seen = ("shift", "yaw", "lever_m", "swing_m", "visual_covariance")
    is_bool = np.ones(len(records), bool)
    for name in ("is_seen", "continues", "has_stereo"):
        is_bool &= records[name].view(np.uint8) <= 1
    by_camera = ~records["is_seen"] | are_numbers(records, *seen)
    by_both = ~records["has_stereo"] | are_numbers(records, "stereo") & (records["stereo"][:, 1] > LEAST_SIGMA)
    of_scale = ~records["continues"] | (records["walk_sigma"] > LEAST_SIGMA)
    of_scale &= records["log_scale"][:, 1] > LEAST_SIGMA
    return is_bool & are_numbers(records, *always) & by_camera & by_both & of_scale
