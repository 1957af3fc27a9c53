# SPDX-License-Identifier: BSD-3-Clause
"""Carries one run out: from a recording to trajectories and numbers in a folder."""

import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict, Optional

import numpy as np

from ceiling_dso_ros.dso import ConfigError
from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.report import EvaluationError, TrajectoryEvaluation, evaluate_trajectory
from ceiling_dso_ros.experiments.sweep.disturbed_recording import DisturbedRecording
from ceiling_dso_ros.experiments.sweep.run_spec import RunSpec
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Recording, TopicNames
from ceiling_dso_ros.io.recording_view import RecordingPart
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.io.warning_log import WarningLog
from ceiling_dso_ros.playback.fusion_playback import usable_fusion
from ceiling_dso_ros.playback.machine_speed import machine_ms
from ceiling_dso_ros.playback.playback import Playback
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.settings import write_settings

PAIRING_S = 0.05  # the reference is interpolated; this only limits how far away its poses may be
UNIT_RUNS = 10  # of the machine's unit, before and after a timed run
# Trajectory -> (its alignment, which reference it is compared with)
COMPARED = {
    "camera": (AlignmentKind.SIM3, "reference"),
    "camera_final": (AlignmentKind.SIM3, "reference"),
    "wheel": (AlignmentKind.SE2, "base_reference"),
    "fused": (AlignmentKind.SE2, "base_reference"),
}
EVALUATION = "evaluation.json"


def open_run(spec: RunSpec, warnings: WarningLog) -> Recording:
    """The recording as the run sees it.

    Raises:
        InputError: it cannot be used.
    """
    opening, conditions = spec.opening, spec.conditions
    recording = open_recording(
        spec.input, TopicNames(**opening.topics), opening.camera, opening.robot, opening.rectified, warnings.add
    )
    recording.uses_exposures = not conditions.no_exposure
    part = RecordingPart(recording, conditions.start, conditions.duration, skip=spec.seed)
    return DisturbedRecording(part, conditions, spec.seed)


def carry_out(spec: RunSpec, folder: Path, timed: bool) -> Dict[str, Any]:
    """Run, evaluate and write all files of `run`, and evaluation.json.

    Args:
        spec: of the run.
        folder: an empty one.
        timed: measure the machine's unit, too.

    Returns:
        The numbers of the run; those that are not known are None.

    Raises:
        InputError: recording or settings cannot be used.
        OutputError: a file cannot be written.
    """
    begin_s = time.perf_counter()
    forget_peak_memory()
    warnings = WarningLog(lambda text: print(f"warning: {text}", flush=True))
    recording = open_run(spec, warnings)
    try:
        size = spec.conditions.image_size()
        visual = VisualRun.of(recording, spec.odometry, size=size, bits=spec.opening.bits, tell=warnings.add)
    except ConfigError as error:
        raise InputError(f"{recording.path}: {error}") from error
    fusion = usable_fusion(recording, spec.fusion, warnings)
    playback = Playback(visual, warnings, fusion, not spec.conditions.no_prediction)
    write_settings(folder / "config.yaml", spec.odometry)
    if fusion is not None:
        write_settings(folder / "fusion.yaml", spec.fusion)
    unit_ms = [machine_ms(UNIT_RUNS)] if timed else []
    playback.play(recording.frames(spec.conditions.fps, None if fusion is None else recording.wheels))
    unit_ms += [machine_ms(UNIT_RUNS)] if timed else []
    warnings.end()
    playback.write(folder, "complete")
    evaluations = _evaluate(spec, folder, warnings)
    numbers = {name: evaluation.numbers() for name, evaluation in evaluations.items()}
    content = json.dumps({"trajectories": numbers}, indent=2, allow_nan=False) + "\n"
    replace_file(folder / EVALUATION, content.encode(), "the numbers")
    return {
        **_counts(playback, visual),
        **_errors(evaluations),
        **_times(playback, unit_ms, time.perf_counter() - begin_s),
    }


def _evaluate(spec: RunSpec, folder: Path, warnings: WarningLog) -> Dict[str, TrajectoryEvaluation]:
    """The trajectories that can be compared."""
    references = {"reference": spec.reference, "base_reference": spec.base_reference}
    evaluations = {}
    for name, (kind, key) in COMPARED.items():
        path, reference = folder / f"{name}.tum", references[key]
        if reference is None or not path.exists():
            continue
        try:
            estimate, truth = read_tum(path), read_tum(Path(reference))
            evaluations[name] = evaluate_trajectory(name, estimate, truth, kind, PAIRING_S, interpolate=True)
        except (EvaluationError, InputError) as error:
            warnings.add(f"{name}: {error}")
    return evaluations


def _counts(playback: Playback, visual: VisualRun) -> Dict[str, Any]:
    summary, camera = playback.summary(), visual.preprocess.camera
    frames = summary["frames"]
    return {
        "image": f"{camera.width}x{camera.height}",
        "rate_hz": round(playback.timing.frame_rate_hz(), 3) if frames > 1 else None,
        "frames": frames,
        "tracked": summary["tracked"],
        "lost": summary["lost"],
        "skipped": summary["skipped"],
        "segments": summary["segments"],
        "keyframes": summary["keyframes"],
        "keyframe_share": summary["keyframes"] / frames,
        "scale_known": summary["scale"]["converged"],
    }


def _errors(evaluations: Dict[str, TrajectoryEvaluation]) -> Dict[str, Optional[float]]:
    """RMSE of each trajectory, and quartiles of the camera's errors."""
    final = evaluations.get("camera_final")
    quartiles = [None] * 3 if final is None else np.percentile(final.position_errors_m, (25, 50, 75)).tolist()
    rmse = {name: evaluations[name].ate_m.rmse if name in evaluations else None for name in COMPARED}
    percent = None if final is None or not final.path_m else 100.0 * final.ate_m.rmse / final.path_m
    return {
        "path_m": None if final is None else final.path_m,
        "ate_m": rmse["camera_final"],
        "ate_percent": percent,
        **dict(zip(("error_q1_m", "error_median_m", "error_q3_m"), quartiles)),
        "live_ate_m": rmse["camera"],
        "fused_ate_m": rmse["fused"],
        "wheel_ate_m": rmse["wheel"],
    }


def _times(playback: Playback, unit_ms: Any, run_s: float) -> Dict[str, Optional[float]]:  # noqa: ANN401
    ms = playback.summary()["ms"]
    return {
        "frame_ms": ms["all"]["mean"],
        "frame_p95_ms": ms["all"]["p95"],
        "keyframe_ms": ms["keyframes"]["mean"],
        "other_ms": ms["others"]["mean"],
        "machine_ms": float(np.mean(unit_ms)) if unit_ms else None,
        "run_s": run_s,
        "memory_mb": peak_memory_mb(),
    }


def forget_peak_memory() -> None:
    """Begin to measure the largest memory of this process anew, where the system can."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_mb() -> Optional[float]:
    """Largest memory of this process since `forget_peak_memory`, None where it is not known."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return None
