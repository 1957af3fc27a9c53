# SPDX-License-Identifier: BSD-3-Clause
"""`run`: from a recording to trajectories."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Collection, List, Mapping, NamedTuple, Optional

from ceiling_dso_ros.cli.outputs import complain, require_output_folder
from ceiling_dso_ros.cli.recording_options import add_recording_options, add_set_option, open_with, visual_run, warn
from ceiling_dso_ros.cli.wheel_options import add_wheel_options, require_usable
from ceiling_dso_ros.io.errors import InputError, OutputError, reason_of
from ceiling_dso_ros.io.interrupts import deferred_interrupt, was_interrupt

if TYPE_CHECKING:
    from ceiling_dso_ros.io.recording import Recording
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.lens.checking import LensCheck
    from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
    from ceiling_dso_ros.playback.playback import Playback
    from ceiling_dso_ros.slam.site_map import SiteMap

MAPPED = "mapped.tum"
FUSION_SETTINGS = "fusion.yaml"
COMPLETE = "complete"  # how a run ends


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "run",
        help="estimate trajectories from a recording",
        description="Track the camera of a recording and write camera.tum, camera_final.tum, keyframes.tum, map.ply, "
        "timing.csv, config.yaml and summary.json into DIR. If the recording has wheels, also write wheel.tum, "
        "fused.tum, fused_smoothed.tum and fusion.yaml. All files are also written after an interruption.",
    )
    add_recording_options(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder; created if missing")
    parser.add_argument("--size", metavar="WxH", help="scale the images down to this size (default: original size)")
    parser.add_argument(
        "--fps",
        metavar="N",
        default="0",
        help="largest number of images used per second; auto: fewer while little moves (default: all)",
    )
    parser.add_argument(
        "--config", metavar="FILE.yaml", type=Path, help="yaml file with settings, such as config.yaml of a run"
    )
    parser.add_argument(
        "--fusion-config",
        metavar="FILE.yaml",
        type=Path,
        help="yaml file with settings of the fusion, such as fusion.yaml of a run",
    )
    add_set_option(parser, "set one value, such as window.max_keyframes=5 or fusion.graph.window=30")
    parser.add_argument(
        "--no-prediction",
        action="store_true",
        help="track the images without the motion that the wheels predict; then camera.tum owes nothing to them",
    )
    parser.add_argument(
        "--map",
        metavar="SITE",
        type=Path,
        help="map of the site: also write mapped.tum, base_link in map; needs wheels",
    )
    add_wheel_options(parser)
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Run odometry and fusion over the whole recording and write the results, also after an error or interruption.

    Raises:
        InputError: wrong settings, unreadable recording, or a folder that cannot be written to.
        OutputError: some files cannot be written at the end; the others are.
    """
    from tqdm import tqdm

    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.settings import write_settings

    warnings = WarningLog(warn)
    run = _prepare(options, warnings)
    require_output_folder(options.out, run.files)
    for name, values in run.settings.items():
        write_settings(options.out / name, values)

    _load_kernels(of_lens=run.check is not None)
    end = COMPLETE
    try:
        # disable=None: no bar where stderr is no terminal
        total = len(run.recording) if run.frame_rate == 0.0 else None
        wheels = None if run.fusion is None else run.recording.wheels
        listed = run.recording.frames(run.frame_rate or 0.0, wheels, run.playback.leaves_out)
        with tqdm(listed, total=total, unit="frame", disable=None) as frames:
            run.playback.play(frames)
        _explain_missing_poses(run.playback, run.recording, run.fusion is not None)
        if run.check is not None:
            _warn_of_lens(run.check, run.playback, run.recording)
        if run.site is not None and run.fusion is not None:
            _write_mapped(options, run.site, run.playback, run.fusion)
    except BaseException as error:
        end = "interrupted" if was_interrupt(error) else f"failed: {type(error).__name__}: {error}"
        raise
    finally:
        warnings.end()
        if len(run.playback.timing):
            _write(run, options.out, end)


class _Run(NamedTuple):
    """What a run needs; None is what it does not have.

    Attributes:
        recording, site, fusion, check, playback: see their classes.
        settings: name of a file -> values that are written to it.
        frame_rate: images a second, 0 for all; None for as many as the motion asks for.
    """

    recording: "Recording"
    site: "Optional[SiteMap]"
    fusion: "Optional[FusionPlayback]"
    check: "Optional[LensCheck]"
    playback: "Playback"
    settings: Mapping[str, object]
    frame_rate: Optional[float]

    @property
    def files(self) -> List[str]:
        """Names of all files that it writes."""
        return [*self.settings, *self.playback.files, *([] if self.site is None else [MAPPED])]


def _prepare(options: argparse.Namespace, warnings: "WarningLog") -> _Run:
    """Find out what is wrong before hours of work.

    Raises:
        InputError: wrong settings, or an unreadable recording.
    """
    from ceiling_dso_ros.dso.config import OdometryConfig
    from ceiling_dso_ros.fusion.config import FusionConfig
    from ceiling_dso_ros.io.frame_rate import parse_frame_rate
    from ceiling_dso_ros.io.image_scaling import parse_image_size
    from ceiling_dso_ros.lens.checking import LensCheck
    from ceiling_dso_ros.playback.fusion_playback import usable_fusion
    from ceiling_dso_ros.playback.playback import Playback
    from ceiling_dso_ros.settings import load_settings, split_overrides
    from ceiling_dso_ros.slam.map_file import read_map, require_camera
    from ceiling_dso_ros.slam.records import RecordCamera

    frame_rate = parse_frame_rate(options.fps, "--fps ")
    of_odometry, of_fusion = split_overrides(options.overrides)
    config = load_settings(options.config, of_odometry, OdometryConfig)
    fusion_config = load_settings(options.fusion_config, of_fusion, FusionConfig)
    site = None if options.map is None else read_map(options.map)
    recording = open_with(options, warnings)
    size = None if options.size is None else parse_image_size(options.size, "--size")
    visual = visual_run(recording, config, options.bits, warnings, size=size)
    if site is not None or options.wheel_input or options.wheel_odometry:
        require_usable(recording)
    fusion = usable_fusion(recording, fusion_config, warnings)
    if options.robot is not None and recording.robot is not None and recording.wheels is None:
        warnings.add(f"{recording.path}: has no wheels, so that {options.robot} is not used")
    if site is not None and recording.robot is not None:
        camera = RecordCamera.of(visual.preprocess.camera, recording.robot.T_base_camera)
        require_camera(options.map, site, camera)
    visual.regulate(frame_rate is None)
    check = None if fusion is None else LensCheck(recording, visual.preprocess.camera)
    playback = Playback(
        visual,
        warnings,
        fusion,
        predict=not options.no_prediction,
        keep_keyframes=site is not None,
        watch=None if check is None else check.add,
    )
    settings = {"config.yaml": config, **({} if fusion is None else {FUSION_SETTINGS: fusion_config})}
    return _Run(recording, site, fusion, check, playback, settings, frame_rate)


def _remove_older(directory: Path, files: Collection[str]) -> None:
    """Remove what an earlier run has left, and this one has not replaced: it would be judged as one of this run.

    Raises:
        OutputError: files cannot be removed; all others are.
    """
    from ceiling_dso_ros.playback.playback import OF_SOME_RUNS

    kept: List[str] = []
    for name in (*OF_SOME_RUNS, FUSION_SETTINGS, MAPPED):
        path = directory / name
        if name in files or not path.is_file():
            continue
        try:
            path.unlink()
            warn(f"{path}: of an earlier run, was removed: this run has no such result")
        except OSError as error:
            kept.append(f"{path}: of an earlier run, and cannot be removed: {reason_of(error)}")
    if kept:
        raise OutputError(*kept)


def _load_kernels(of_lens: bool) -> None:
    from ceiling_dso_ros.dso import warmup
    from ceiling_dso_ros.lens import warmup as lens_warmup

    for kernels in (warmup, lens_warmup) if of_lens else (warmup,):
        kernels.load_kernels(lambda message: print(message, file=sys.stderr))


def _warn_of_lens(check: "LensCheck", playback: "Playback", recording: "Recording") -> None:
    problem = check.problem()
    if problem is not None:
        playback.warnings.add(f"{recording.path}: {problem}")


def _write_mapped(options: argparse.Namespace, site: "SiteMap", playback: "Playback", fusion: "FusionPlayback") -> None:
    """Find the drive in a map.

    Raises:
        InputError: the drive has no metric poses.
        OutputError: the file cannot be written.
    """
    from ceiling_dso_ros.io.trajectory import write_tum
    from ceiling_dso_ros.playback.mapping import MappedDrive, localise

    drive = MappedDrive.of(playback, fusion, options.input)
    found = localise(site, drive)
    if found.first_m is None:
        playback.warnings.add(f"{options.input}: was not found in {options.map}, so that {MAPPED} is empty")
    write_tum(options.out / MAPPED, found.trajectory(drive.fused))


def _write(run: _Run, directory: Path, end: str) -> None:
    """Write what was computed, and say what it is.

    Raises:
        OutputError: files cannot be written. After a run that was not complete they are said beside its own error.
    """
    try:
        with deferred_interrupt():  # impatient users press Ctrl-C twice
            run.playback.write(directory, end)
            _remove_older(directory, run.files)
    except OutputError as error:
        if end == COMPLETE:
            raise
        for line in error.lines:
            complain(line)
    finally:
        print(_describe(run.playback.summary(), directory))


def _explain_missing_poses(playback: "Playback", recording: "Recording", has_wheels: bool) -> None:
    """Say why less than half of the images have a pose.

    Raises:
        InputError: none has one, and there are no wheels: all trajectories are empty.
    """
    summary = playback.summary()
    if 2 * summary["tracked"] >= summary["frames"]:
        return
    reason, count = playback.why_untracked()
    text = (
        f"{recording.path}: {summary['tracked']} of {summary['frames']} images have a pose; "
        f"the most frequent reason ({count} images): {reason}"
    )
    if summary["tracked"] == 0 and not has_wheels:
        raise InputError(text)
    playback.warnings.add(text)


def _describe(summary: dict, directory: Path) -> str:
    segments, mean_ms = summary["segments"], summary["ms"]["all"]["mean"]
    parts = [
        f"{summary['tracked']} of {summary['frames']} frames tracked",
        f"{summary['lost']} lost",
        f"{summary['skipped']} skipped",
        f"{summary['keyframes']} keyframes",
    ]
    if segments > 1:
        parts.append(f"{segments} segments, each with its own unit of length")
    if mean_ms is not None:
        parts.append(f"{mean_ms:.1f} ms a frame")
    return f"{', '.join(parts)}; results in {directory}"
