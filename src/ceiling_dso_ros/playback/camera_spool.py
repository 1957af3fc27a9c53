# SPDX-License-Identifier: BSD-3-Clause
"""What dso_node keeps of a run on the disk, and the trajectories that are made of it."""

import threading
from pathlib import Path
from typing import BinaryIO, Dict, List, Tuple

import numpy as np

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.io.trajectory import Trajectory, tum_lines
from ceiling_dso_ros.playback.spool import Spool, SpoolFolder
from ceiling_dso_ros.playback.spool_records import Tell, are_poses, read_records

FRAMES, KEYFRAMES, NEWEST_KEYFRAMES = "frames.bin", "keyframes.bin", "keyframes.newest.bin"
# An hour of 30 images and five keyframes a second takes 12, 12 and 2 MB.
SHARES = {"camera.tum": 0.45, FRAMES: 0.45, KEYFRAMES: 0.1}
FRAME = np.dtype([("stamp_ns", "<i8"), ("keyframe_id", "<i8"), ("T_keyframe_camera", "<f8", (3, 4))])
KEYFRAME = np.dtype(
    [("keyframe_id", "<i8"), ("stamp_ns", "<i8"), ("segment", "<i8"), ("T_world_camera", "<f8", (3, 4))]
)
MOST_FRAMES = 50_000  # that wait for a disk that does not answer, half an hour


class CameraSpool(Spool):
    """camera.tum as it will be, the poses on their keyframes, FRAME, and the keyframes as last refined, KEYFRAME."""

    def __init__(self, folder: SpoolFolder, limit: int) -> None:
        """Begin; limit: of the sizes of all files together, bytes."""
        super().__init__(folder, {name: int(share * limit) for name, share in SHARES.items()})
        self._lock = threading.Lock()
        self._poses: List[Tuple[int, np.ndarray]] = []
        self._window: Dict[int, KeyframeEstimate] = {}
        self._run = 0

    def add(self, status: OdometryStatus) -> None:
        """Keep the result of an image; images must be in the order of time."""
        if status.keyframes:
            self._refine({keyframe.keyframe_id: keyframe for keyframe in status.keyframes})
        if status.T_world_camera is None or status.T_keyframe_camera is None:
            return
        frame = np.array((status.stamp_ns, status.keyframe_id, status.T_keyframe_camera[:3]), FRAME)
        with self._lock:
            if len(self._poses) >= MOST_FRAMES:
                self._never_collected += len(self._poses)
                self._poses = []
            self._poses.append((status.stamp_ns, status.T_world_camera))
            self._files[FRAMES].append(frame.tobytes())

    def newest(self) -> Dict[str, bytes]:
        """The keyframes that are still refined as they are now, for `beside`."""
        return {NEWEST_KEYFRAMES: b"".join(map(_record, self._window.values()))}

    def clear(self) -> None:
        """See Spool."""
        with self._lock:
            self._run += 1
            self._poses, self._window = [], {}
            super().clear()

    def _refine(self, window: Dict[int, KeyframeEstimate]) -> None:
        """Take in the window; what has left it is final."""
        for keyframe_id, keyframe in self._window.items():
            if keyframe_id not in window:
                self._files[KEYFRAMES].append(_record(keyframe))
        self._window = window

    def _collect(self) -> None:
        with self._lock:
            poses, self._poses, run = self._poses, [], self._run
        lines = tum_lines(Trajectory.from_matrices([stamp_ns for stamp_ns, _ in poses], [T for _, T in poses]))
        with self._lock:
            if run == self._run:
                self._files["camera.tum"].append(lines, len(poses))


def _record(keyframe: KeyframeEstimate) -> bytes:
    values = (keyframe.keyframe_id, keyframe.stamp_ns, keyframe.segment, keyframe.T_world_camera[:3])
    return np.array(values, KEYFRAME).tobytes()


def write_final(folder: Path, file: BinaryIO, tell: Tell) -> int:
    """Write the poses with the last estimate of their keyframes, of what a CameraSpool has kept; returns their number.

    Poses whose keyframe is not known are left out: those of the newest keyframes when the node was killed. What is
    damaged is left out and told.

    Raises:
        InputError: the folder cannot be read.
    """
    keyframes = _kept_keyframes(folder, tell)
    count = 0
    for frames in read_records(folder / FRAMES, FRAME, lambda found: are_poses(found["T_keyframe_camera"]), tell):
        at = np.searchsorted(keyframes["keyframe_id"], frames["keyframe_id"])
        known = at < len(keyframes)
        known[known] = keyframes["keyframe_id"][at[known]] == frames["keyframe_id"][known]
        T_world_keyframe = _matrices(keyframes["T_world_camera"][at[known]])
        T_world_camera = T_world_keyframe @ _matrices(frames["T_keyframe_camera"][known])
        file.write(tum_lines(Trajectory.from_matrices(frames["stamp_ns"][known], T_world_camera)))
        count += int(known.sum())
    return count


def write_keyframes(folder: Path, file: BinaryIO, tell: Tell) -> int:
    """Write the keyframes as last refined, of what a CameraSpool has kept; returns their number.

    Raises:
        InputError: the folder cannot be read.
    """
    keyframes = _kept_keyframes(folder, tell)
    keyframes = keyframes[np.argsort(keyframes["stamp_ns"], kind="stable")]
    file.write(tum_lines(Trajectory.from_matrices(keyframes["stamp_ns"], _matrices(keyframes["T_world_camera"]))))
    return len(keyframes)


def _kept_keyframes(folder: Path, tell: Tell) -> np.ndarray:
    """(N,) KEYFRAME by their ids."""
    # The newest are last, because what has left the window is final.
    keyframes = np.concatenate(
        [
            np.zeros(0, KEYFRAME),
            *read_records(folder / KEYFRAMES, KEYFRAME, _are_keyframes, tell),
            *read_records(folder / NEWEST_KEYFRAMES, KEYFRAME, _are_keyframes, tell),
        ]
    )
    return keyframes[np.unique(keyframes["keyframe_id"], return_index=True)[1]]


def _are_keyframes(records: np.ndarray) -> np.ndarray:
    return are_poses(records["T_world_camera"])


def _matrices(T: np.ndarray) -> np.ndarray:
    """(N, 4, 4) of (N, 3, 4)."""
    return np.concatenate([T, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(T), 1, 1))], axis=1)
