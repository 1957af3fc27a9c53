# SPDX-License-Identifier: BSD-3-Clause
"""`benchmark`: time per frame and per stage."""

import argparse
import json
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Optional, Tuple

from ceiling_dso_ros.cli.outputs import require_output_folder
from ceiling_dso_ros.cli.recording_options import add_recording_options, add_set_option, open_with, visual_run, warn
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.dso import OdometryConfig
    from ceiling_dso_ros.io.recording import Recording
    from ceiling_dso_ros.io.warning_log import WarningLog

RESULT = "benchmark.json"
Report = Tuple[Dict[str, Any], str]  # what is written, and what is printed


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "benchmark",
        help="measure the time per frame and per stage",
        description="Track a recording several times without dropping frames, and print the median times in "
        "milliseconds and in a unit that hardly depends on the machine.",
    )
    add_recording_options(parser)
    parser.add_argument("--repeats", metavar="N", type=int, default=3, help="passes over the recording (default 3)")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--vs", metavar="FOLDER", type=Path, help="compare with benchmark.json or reference.json in this folder"
    )
    kind.add_argument(
        "--live", metavar="RATE", type=float, help="play it once at RATE times real time and drop late images"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for benchmark.json; created if missing")
    parser.add_argument(
        "--config", metavar="FILE.yaml", type=Path, help="yaml file with settings, such as config.yaml of a run"
    )
    add_set_option(parser, "one setting")
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Measure and print.

    Raises:
        InputError: wrong options or settings, unreadable recording, or a folder that cannot be written to.
        OutputError: the result cannot be written; it is printed.
    """
    from tqdm import tqdm

    from ceiling_dso_ros.dso.config import OdometryConfig
    from ceiling_dso_ros.dso.warmup import load_kernels
    from ceiling_dso_ros.io.replacing import replace_file
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.playback.benchmark import read_reference
    from ceiling_dso_ros.settings import load_settings

    if options.repeats < 1:
        raise InputError(f"--repeats {options.repeats}: at least 1")
    if options.live is not None and not 0.01 <= options.live <= 100.0:
        raise InputError(f"--live {options.live}: 0.01 to 100")
    reference = read_reference(options.vs) if options.vs is not None else None
    config = load_settings(options.config, options.overrides, OdometryConfig)
    if options.out is not None:
        require_output_folder(options.out, [RESULT])
    warnings = WarningLog(warn)
    recording = open_with(options, warnings)
    load_kernels(tqdm.write)
    if options.live is not None:
        result, text = _measure_live(recording, config, options, warnings)
    else:
        result, text = _measure(recording, config, options, warnings, reference)
    try:
        if options.out is not None:
            numbers = json.dumps(result, indent=2, allow_nan=False)
            replace_file(options.out / RESULT, f"{numbers}\n".encode(), "the result")
    finally:
        print(text)


def _measure(
    recording: "Recording",
    config: "OdometryConfig",
    options: argparse.Namespace,
    warnings: "WarningLog",
    reference: Optional[dict],
) -> Report:
    """Several runs without dropping frames."""
    from tqdm import tqdm

    from ceiling_dso_ros.io.warning_log import WarningLog, ignore_warning
    from ceiling_dso_ros.playback.benchmark import describe, run_once, summarize
    from ceiling_dso_ros.playback.playback import Playback

    runs = []
    for number in tqdm(range(options.repeats), unit="pass", disable=None):
        told = warnings if number == 0 else WarningLog(ignore_warning)  # the others would repeat it all
        playback = Playback(visual_run(recording, config, options.bits, told), told)
        runs.append(run_once(playback, recording.frames()))
    warnings.end()
    result = summarize(runs)
    return result, describe(result, reference)


def _measure_live(
    recording: "Recording", config: "OdometryConfig", options: argparse.Namespace, warnings: "WarningLog"
) -> Report:
    """One run in real time or faster, with the mapping in its own thread; all images are read first."""
    from ceiling_dso_ros.dso import OdometryStatus
    from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler
    from ceiling_dso_ros.io.recording import Frame, SkippedFrame
    from ceiling_dso_ros.playback.live_benchmark import describe, play_live

    frames = []
    for frame in recording.frames():
        if isinstance(frame, SkippedFrame):
            warnings.add(frame.reason, frame.kind)
        else:
            frames.append(frame)
    warnings.end()
    if len(frames) < 2:
        raise InputError(f"{len(frames)} usable images: a benchmark needs at least 2")
    with closing(LiveScheduler()) as scheduler:
        visual = visual_run(recording, config, options.bits, warnings, scheduler)

        def track(frame: Frame) -> OdometryStatus:
            return visual.track(frame.image, frame.stamp_ns, frame.exposure_ms).status

        result = play_live(frames, track, options.live).summary()
    return result, describe(result)
