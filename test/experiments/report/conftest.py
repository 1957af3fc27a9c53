# SPDX-License-Identifier: BSD-3-Clause
"""Studies whose runs are made up: the report knows nothing of how a run came about."""

import numpy as np
import pytest

from ceiling_dso_ros.experiments.report.study import read_study
from ceiling_dso_ros.experiments.sweep.plan import Plan
from ceiling_dso_ros.experiments.sweep.store import Store
from ceiling_dso_ros.experiments.sweep.supervision import Outcome
from ceiling_dso_ros.experiments.sweep.sweep import PlannedRun
from ceiling_dso_ros.io.trajectory import Trajectory, write_tum

GRID = {"size": ["848x480", "424x240"], "fps": ["3", "6", "15", "30"], "window.max_keyframes": ["5", "7", "15"]}
BASELINE = {"size": "848x480", "fps": "30", "window.max_keyframes": "7"}
STAMPS_NS = np.arange(0, 20_000_000_000, 100_000_000)


def true_path(number):
    """A square-like path, and one with small loops."""
    t = np.linspace(0.0, 2.0 * np.pi, len(STAMPS_NS))
    x, y = (8.0 * np.cos(t), 6.0 * np.sin(t)) if number == 0 else (8.0 * np.cos(t), 3.0 * np.sin(3.0 * t))
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    return Trajectory(STAMPS_NS, np.column_stack([x, y, np.zeros_like(t)]), quaternions)


def made_up_numbers(spec, rng, errors_m, factor):
    fps, window = spec.conditions.fps, spec.odometry.window.max_keyframes
    frames = int(20 * fps)
    return {
        "image": spec.conditions.size, "rate_hz": fps, "frames": frames, "tracked": frames - 3, "skipped": 0,
        "lost": int(fps == 3 and spec.sequence == "loops"), "segments": 1, "keyframes": frames // 5,
        "keyframe_share": min(1.0, 3.0 / fps), "scale_known": False, "path_m": 44.0,
        "ate_m": float(np.sqrt(np.mean(errors_m**2))) * factor, "ate_percent": 0.1, "live_ate_m": 0.01,
        "frame_ms": (12.0 + window + 90.0 / fps) * rng.uniform(0.97, 1.03), "memory_mb": 412.5, "run_s": 3.0,
    }  # fmt: skip


def write_made_up_study(folder, plan, first_seed=0, factor=1.0, failing=()):
    """Each run has errors of its own; `factor` makes all of them worse, `failing` are the numbers of runs that hang."""
    store, runs = Store(folder), []
    references = {}
    for number, sequence in enumerate(plan.inputs):
        references[sequence] = folder.parent / f"{sequence}.tum"
        write_tum(references[sequence], true_path(number))
    with store.locked():
        for number, spec in enumerate(plan.runs()):
            path = references[spec.sequence]
            object.__setattr__(spec, "reference", str(path))
            store.keep_reference(str(path))
            rng = np.random.default_rng([number, first_seed + spec.seed])
            files = store.unfinished()
            truth = true_path([*plan.inputs].index(spec.sequence))
            noise = np.cumsum(rng.normal(0.0, 0.002 * (1.0 + 3.0 / spec.conditions.fps), truth.positions.shape), axis=0)
            write_tum(
                files / "camera_final.tum", Trajectory(STAMPS_NS, truth.positions + noise, truth.quaternions_xyzw)
            )
            outcome = Outcome("done", "", made_up_numbers(spec, rng, np.linalg.norm(noise, axis=1), factor))
            if number in failing:
                outcome = Outcome("hung", "not done after 7200 s; its last words: <&> waiting")
            row = store.keep(f"{number:016x}", spec, outcome, files, True, "robot")
            runs.append(PlannedRun(f"{number:016x}", spec, row))
        store.write_table(plan, [run.as_row() for run in runs])


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Plan, "_references", lambda self, path: (None, None))
        yield lambda *names, **options: make_up(tmp_path_factory.mktemp("studies"), *names, **options)


def make_up(folder, name="study", grid=GRID, seeds=1, **options):
    for sequence in ("square", "loops"):
        (folder / f"{sequence}.bag").write_text(sequence)
    inputs = {sequence: [str(folder / f"{sequence}.bag")] for sequence in ("square", "loops")}
    baseline = {key: value for key, value in BASELINE.items() if value in grid.get(key, ())}
    write_made_up_study(folder / name, Plan(inputs, grid, seeds=seeds, baseline=baseline), **options)
    return read_study(folder / name)
