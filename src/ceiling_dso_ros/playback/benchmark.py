# SPDX-License-Identifier: BSD-3-Clause
"""Measures the cost of a recording: time per kind of frame and per stage, peak memory, speed factor."""

import json
import math
import resource
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence

import numpy as np
from tabulate import tabulate

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.text_files import read_text
from ceiling_dso_ros.playback.machine_speed import machine_ms
from ceiling_dso_ros.playback.playback import Playback

KINDS = ("all", "keyframes", "others")
REFERENCE_KEYS = {
    "all": "frame_ms_over_machine_ms",
    "keyframes": "keyframe_ms_over_machine_ms",
    "others": "other_frame_ms_over_machine_ms",
}


@dataclass(frozen=True)
class BenchmarkRun:
    """One pass over a recording.

    Attributes:
        frames, tracked, lost: counts.
        frame_ms: mean wall time of a frame by kind: all, keyframes, others that were tracked.
        stage_ms: for each kind, the mean of every stage.
        frame_rate_hz: of the recording.
        machine_ms: the machine's unit, before and after, milliseconds.
    """

    frames: int
    tracked: int
    lost: int
    frame_ms: Dict[str, Optional[float]]
    stage_ms: Dict[str, Dict[str, float]]
    frame_rate_hz: float
    machine_ms: Sequence[float]


def run_once(playback: Playback, frames: Iterable[Any]) -> BenchmarkRun:
    """Play frames through a fresh odometry; reading them is not measured.

    Raises:
        InputError: fewer than two frames can be used.
    """
    before = machine_ms()
    playback.play(frames)
    after = machine_ms()
    summary, timing = playback.summary(), playback.timing
    if summary["frames"] < 2:
        raise InputError(f"{summary['frames']} usable images: a benchmark needs at least 2")
    return BenchmarkRun(
        frames=summary["frames"],
        tracked=summary["tracked"],
        lost=summary["lost"],
        frame_ms={kind: summary["ms"][kind]["mean"] for kind in KINDS},
        stage_ms=timing.stage_means_ms(),
        frame_rate_hz=timing.frame_rate_hz(),
        machine_ms=(before, after),
    )


def summarize(runs: Sequence[BenchmarkRun]) -> Dict[str, Any]:
    """Result for benchmark.json: medians over one or more runs, in milliseconds and in the machine's unit.

    The speed factor is 1 / (t_F f), with the mean time t_F of a frame and the frame rate f.
    """
    unit = float(np.median([np.mean(run.machine_ms) for run in runs]))
    frame_ms = {kind: _median([run.frame_ms[kind] for run in runs]) for kind in KINDS}
    mean_ms, rate_hz = frame_ms["all"], runs[0].frame_rate_hz
    return {
        "frames": runs[0].frames,
        "tracked": runs[0].tracked,
        "lost": runs[0].lost,
        "runs": len(runs),
        "machine_ms": unit,
        "machine_ms_of_runs": [list(run.machine_ms) for run in runs],
        "frame_ms": frame_ms,
        "frame_units": {kind: None if ms is None else ms / unit for kind, ms in frame_ms.items()},
        "stage_ms": {
            kind: {stage: _median([run.stage_ms[kind].get(stage) for run in runs]) for stage in stages}
            for kind, stages in runs[0].stage_ms.items()
        },
        "frame_rate_hz": rate_hz,
        "speed_factor": None if mean_ms is None else 1e3 / (mean_ms * rate_hz),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def read_reference(folder: Path) -> Dict[str, Optional[float]]:
    """Frame times in the machine's unit by kind, of a folder with an earlier benchmark.json or a reference.json.

    Raises:
        InputError: there is neither, or it cannot be read.
    """
    own, other = folder / "benchmark.json", folder / "reference.json"
    path = own if own.is_file() else other
    if not path.is_file():
        raise InputError(f"{folder}: neither benchmark.json nor reference.json is there")
    text = read_text(path)
    try:
        content = json.loads(text)
        found = content["frame_units"] if path == own else {kind: content[key] for kind, key in REFERENCE_KEYS.items()}
        return {kind: None if value is None else _units(value) for kind, value in found.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: not the result of a benchmark: {error}") from error


def _units(value: float) -> float:
    if not 0.0 < value < math.inf:
        raise ValueError(f"{value} is no time")
    return float(value)


def describe(result: Mapping[str, Any], reference: Optional[Mapping[str, Optional[float]]] = None) -> str:
    """Two tables: frames by kind, against a reference's if there is one, and the stages."""
    rows: List[Dict[str, Any]] = []
    for kind in KINDS:
        row = {"frames": kind, "ms": result["frame_ms"][kind], "units": result["frame_units"][kind]}
        if reference is not None:
            theirs, ours = reference.get(kind), result["frame_units"][kind]
            row.update({"reference units": theirs, "ratio": ours / theirs if ours and theirs else None})
        rows.append(row)
    stages = sorted({stage for kinds in result["stage_ms"].values() for stage in kinds})
    stage_rows = [
        {"stage (ms)": stage, **{kind: result["stage_ms"][kind].get(stage) for kind in result["stage_ms"]}}
        for stage in stages
    ]
    lines = [
        tabulate(rows, headers="keys", floatfmt=".2f", missingval="-"),
        "",
        tabulate(stage_rows, headers="keys", floatfmt=".2f", missingval="-"),
        "",
        f"unit of this machine {result['machine_ms']:.2f} ms; {result['tracked']} of {result['frames']} frames "
        f"tracked; speed factor {result['speed_factor']:.2f} at {result['frame_rate_hz']:.1f} Hz; "
        f"peak memory {result['peak_memory_mb']:.0f} MB",
    ]
    return "\n".join(lines)


def _median(values: Sequence[Optional[float]]) -> Optional[float]:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
