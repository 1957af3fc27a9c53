# SPDX-License-Identifier: BSD-3-Clause
"""How long each frame took, by stage."""

from array import array
from pathlib import Path
from typing import Any, Dict, List

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.stamps import format_stamp


class TimingLog:
    """One row for every frame that the odometry was given."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._total_ms = array("d")
        self._stages_ms: Dict[str, array] = {}
        self._is_keyframe: List[bool] = []
        self._states: List[TrackingState] = []

    def __len__(self) -> int:
        return len(self._states)

    def add(self, status: OdometryStatus, total_ms: float) -> None:
        """Record one frame.

        Args:
            status: the result, with the milliseconds of the stages that this frame went through.
            total_ms: wall time from the raw image to the result, milliseconds.
        """
        for name in status.timing_ms:
            self._stages_ms.setdefault(name, array("d", [0.0] * len(self)))
        for name, column in self._stages_ms.items():
            column.append(status.timing_ms.get(name, 0.0))
        self._stamps_ns.append(status.stamp_ns)
        self._total_ms.append(total_ms)
        self._is_keyframe.append(status.is_keyframe)
        self._states.append(status.state)

    def count(self, state: TrackingState) -> int:
        """Number of frames that ended in state."""
        return self._states.count(state)

    def statistics_ms(self) -> Dict[str, Any]:
        """Mean, median, p95 and max of a frame: of `all`, of `keyframes`, and of the `others` that were tracked."""
        total_ms = np.array(self._total_ms)
        kinds = {kind: _statistics(total_ms[which]) for kind, which in self._kinds().items()}
        return {"all": _statistics(total_ms), **kinds}

    def frame_rate_hz(self) -> float:
        """Of the recording: one over the median interval; two frames at least."""
        return 1.0 / seconds(float(np.median(np.diff(self._stamps_ns))))

    def stage_means_ms(self) -> Dict[str, Dict[str, float]]:
        """Mean of every stage that took part: of `keyframes`, and of the `others` that were tracked."""
        means: Dict[str, Dict[str, float]] = {}
        for kind, which in self._kinds().items():
            columns = {name: np.array(column)[which] for name, column in self._stages_ms.items()}
            means[kind] = {name: float(values.mean()) for name, values in columns.items() if values.any()}
        return means

    def _kinds(self) -> Dict[str, np.ndarray]:
        is_keyframe = np.array(self._is_keyframe, dtype=bool)
        tracked = np.array([state is TrackingState.TRACKING for state in self._states], dtype=bool)
        return {"keyframes": is_keyframe, "others": tracked & ~is_keyframe}

    def write_csv(self, path: Path) -> None:
        """Write stamp (s), total_ms, a column of milliseconds for each stage, is_keyframe (0 or 1), state.

        Raises:
            OutputError: the file cannot be written.
        """
        rows = [["stamp", "total_ms", *(f"{name}_ms" for name in self._stages_ms), "is_keyframe", "state"]]
        for stamp_ns, is_keyframe, state, *milliseconds in zip(
            self._stamps_ns, self._is_keyframe, self._states, self._total_ms, *self._stages_ms.values()
        ):
            times = [f"{value:.3f}" for value in milliseconds]
            rows.append([format_stamp(stamp_ns), *times, str(int(is_keyframe)), state.value])
        replace_file(path, "".join(",".join(row) + "\n" for row in rows).encode(), "the times")


def _statistics(values_ms: np.ndarray) -> Dict[str, Any]:
    if len(values_ms) == 0:
        return {"mean": None, "median": None, "p95": None, "max": None}
    return {
        "mean": float(values_ms.mean()),
        "median": float(np.median(values_ms)),
        "p95": float(np.percentile(values_ms, 95)),
        "max": float(values_ms.max()),
    }
