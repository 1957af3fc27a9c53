# SPDX-License-Identifier: BSD-3-Clause
"""`sweep`: a study of many runs, with all combinations of settings."""

import argparse
import importlib.util
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Dict, List, Optional, Sequence

from ceiling_dso_ros.cli.outputs import require_names_as_text, require_output_folder
from ceiling_dso_ros.cli.recording_options import add_camera_options, topics_of_camera
from ceiling_dso_ros.cli.wheel_options import add_wheel_options, topics_of_wheels
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.experiments.sweep.executors import Executor
    from ceiling_dso_ros.experiments.sweep.plan import Plan
    from ceiling_dso_ros.experiments.sweep.sweep import PlannedRun

EPILOG = """dimensions: all settings of `run --set` (window.max_keyframes, fusion.graph.window, ...); of the recording
size, fps, start, duration, no_exposure, no_prediction; disturbances drop (share of the images), noise (grey levels),
blur (pixels), exposure (share of the brightness), stamp_jitter (seconds). A seed draws the disturbances, and leaves out
as many images at the begin as its number."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "sweep",
        help="run a study: recordings x settings x seeds",
        description="Run all combinations of settings over recordings. Each run has a folder in DIR/runs, and a row in "
        "DIR/runs.csv; DIR/report.html shows all. What an earlier sweep has done is not done again.",
        epilog=EPILOG,
    )
    parser.add_argument("inputs", metavar="INPUT", nargs="*", help="ROS 1 bags, or folders in the TUM-mono layout")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder of the study; may exist")
    parser.add_argument("--plan", metavar="FILE.yaml", type=Path, help="inputs, grid, set, seeds, references, baseline")
    parser.add_argument(
        "--grid", metavar="key=v1,v2", action="append", default=[], help="a dimension and its values; may be repeated"
    )
    parser.add_argument(
        "--set", metavar="key=value", dest="constants", action="append", default=[], help="a value of all runs"
    )
    parser.add_argument("--seeds", metavar="N", type=int, help="seeds 0 to N-1 for each combination (default 1)")
    parser.add_argument(
        "--baseline", metavar="key=value", action="append", default=[], help="what the report compares with; repeated"
    )
    parser.add_argument("--dry-run", action="store_true", help="print the runs, and carry none out")
    parser.add_argument("--retry-failed", action="store_true", help="carry runs out again that were not done")
    parser.add_argument("--timed", action="store_true", help="one run at a time, on a core of its own")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--jobs", metavar="N", type=int, help="runs at a time (default: one for each core)")
    place.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="run on the workers of this Dask scheduler")
    parser.add_argument(
        "--time-limit", metavar="S", type=float, default=7200.0, help="of a run, seconds (default %(default)g)"
    )
    parser.add_argument(
        "--memory-limit", metavar="MB", type=float, default=4000.0, help="of a run, MB (default %(default)g)"
    )
    add_camera_options(parser)
    add_wheel_options(parser)
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Carry the study out.

    Raises:
        InputError: a wrong option or plan, a recording that cannot be used, or a folder that cannot be written to.
        OutputError: a result cannot be written.
        SystemExit: with code 1, after lines that name them, if runs are not done.
    """
    from ceiling_dso_ros.experiments.report.page import write_report
    from ceiling_dso_ros.experiments.report.study import read_study
    from ceiling_dso_ros.experiments.sweep.store import TABLE, Store
    from ceiling_dso_ros.experiments.sweep.sweep import carry_out, planned

    plan = _plan(options)
    _check_numbers(options)
    store = Store(options.out)
    if options.dry_run:
        _print_plan(planned(plan, store, options.timed, options.retry_failed))
        return
    require_output_folder(options.out, [TABLE])
    with store.locked():
        runs = planned(plan, store, options.timed, options.retry_failed)
        executor = _executor(options)
        with _Progress(runs) as progress:
            runs = carry_out(plan, runs, store, executor, options.timed, progress.ended)
    undone = [run for run in runs if _is_undone(run)]
    report = write_report(read_study(options.out))
    print(f"{len(runs) - len(undone)} of {len(runs)} runs are done; {options.out / TABLE}, {report}")
    for run in undone:
        print(f"{run.name}: {_words(run)}: {_status(run)}", file=sys.stderr)
    if undone:
        sys.exit(1)


class _Progress:
    """A bar over the work of all runs, so that it knows the time left."""

    def __init__(self, runs: "Sequence[PlannedRun]") -> None:
        from tqdm import tqdm

        self._counts: Dict[str, int] = {"done": 0, "not done": 0}
        self._work = {run.name: run.spec.work() for run in runs if run.row is None}
        self._total = len(self._work)
        self._bar = tqdm(
            total=sum(self._work.values()),
            disable=None,
            bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}",
        )
        self._describe()

    def __enter__(self) -> "_Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def ended(self, run: "PlannedRun") -> None:
        """Count a run."""
        done = not _is_undone(run)
        self._counts["done" if done else "not done"] += 1
        if not done:
            self._bar.write(f"{run.name}: {_words(run)}: {_status(run)}", file=sys.stderr)
        self._bar.update(self._work[run.name])
        self._describe()

    def _describe(self) -> None:
        failed = self._counts["not done"]
        self._bar.set_description_str(
            f"{sum(self._counts.values())} of {self._total} runs{f', {failed} not done' if failed else ''}"
        )


def _plan(options: argparse.Namespace) -> "Plan":
    from ceiling_dso_ros.experiments.sweep.plan import Plan, by_sequence, check_plan, parse_grid, read_plan
    from ceiling_dso_ros.experiments.sweep.run_spec import Opening

    require_names_as_text([options.out, options.camera, options.robot, *options.inputs])
    plan = Plan({}) if options.plan is None else read_plan(options.plan)
    opening = Opening(
        {**topics_of_camera(options), **topics_of_wheels(options)},
        _absolute(options.camera),
        _absolute(options.robot),
        options.rectified,
        options.bits,
    )
    plan = replace(
        plan,
        inputs={**plan.inputs, **by_sequence(options.inputs)},
        grid={**plan.grid, **dict(map(parse_grid, options.grid))},
        constant={**plan.constant, **_pairs(options.constants, "--set")},
        seeds=plan.seeds if options.seeds is None else options.seeds,
        baseline={**plan.baseline, **_pairs(options.baseline, "--baseline")},
        opening=opening,
    )
    check_plan(plan, "the plan")
    return plan


def _absolute(path: Optional[Path]) -> Optional[str]:
    return None if path is None else str(path.absolute())


def _pairs(texts: Sequence[str], option: str) -> Dict[str, str]:
    pairs: List[List[str]] = [text.split("=", 1) for text in texts]
    for text, pair in zip(texts, pairs):
        if len(pair) != 2 or not pair[0]:
            raise InputError(f"{option} {text}: expected key=value")
    return {pair[0]: pair[1] for pair in pairs}


def _check_numbers(options: argparse.Namespace) -> None:
    if options.jobs is not None and options.jobs < 1:
        raise InputError(f"--jobs {options.jobs}: at least 1")
    for name in ("time_limit", "memory_limit"):
        if not 0.0 < getattr(options, name) < float("inf"):
            raise InputError(f"--{name.replace('_', '-')} {getattr(options, name):g}: above 0")


def _executor(options: argparse.Namespace) -> "Executor":
    from ceiling_dso_ros.experiments.sweep.dask_executor import DaskExecutor
    from ceiling_dso_ros.experiments.sweep.executors import LocalExecutor
    from ceiling_dso_ros.experiments.sweep.supervision import Limits

    limits = Limits(options.time_limit, options.memory_limit)
    if options.scheduler is None:
        return LocalExecutor(options.jobs or len(os.sched_getaffinity(0)), limits, options.timed, _say)
    if importlib.util.find_spec("distributed") is None:
        raise InputError("--scheduler needs Dask: pip install 'ceiling_dso_ros[study]'")
    return DaskExecutor(options.scheduler, limits, options.timed)


def _say(message: str) -> None:
    print(message, file=sys.stderr)


def _print_plan(runs: "Sequence[PlannedRun]") -> None:
    for run in runs:
        print(f"{run.name}  {_words(run)}: {_status(run)}")
    missing = sum(run.row is None for run in runs)
    print(f"{len(runs)} runs, {missing} of them to be carried out")


def _words(run: "PlannedRun") -> str:
    return " ".join(
        [run.spec.sequence, run.spec.drive, *(f"{k}={v}" for k, v in run.spec.varied.items()), f"seed={run.spec.seed}"]
    )


def _is_undone(run: "PlannedRun") -> bool:
    from ceiling_dso_ros.experiments.sweep.answering import DONE

    return run.row is None or run.row["status"] != DONE


def _status(run: "PlannedRun") -> str:
    if run.row is None:
        return "to be carried out"
    return f"{run.row['status']}: {run.row['message']}" if run.row["message"] else str(run.row["status"])
