# SPDX-License-Identifier: BSD-3-Clause
"""`run`: from a recording to trajectories."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Optional

from ceiling_dso_ros.cli.output_folder import output_folder
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.interrupts import was_interrupt

if TYPE_CHECKING:
    from ceiling_dso_ros.dso import OdometryConfig
    from ceiling_dso_ros.fusion.config import FusionConfig
    from ceiling_dso_ros.io.recording import Recording
    from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
    from ceiling_dso_ros.playback.visual_run import VisualRun

FUSION_PREFIX = "fusion."  # of the fusion's settings among all


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "run",
        help="estimate trajectories from a recording",
        description="Track the camera of a recording and write camera.tum, camera_final.tum, keyframes.tum, map.ply, "
        "timing.csv, config.yaml and summary.json into DIR. If the recording has wheels, also write wheel.tum, "
        "fused.tum, fused_smoothed.tum and fusion.yaml. All files are also written after an interruption.",
    )
    parser.add_argument("input", metavar="INPUT", type=Path, help="a ROS 1 bag, or a folder in the TUM-mono layout")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder; created if missing")
    parser.add_argument(
        "--camera", metavar="camera.txt", type=Path, help="calibration to use instead of the recording's"
    )
    parser.add_argument("--robot", metavar="robot.yaml", type=Path, help="dimensions to use instead of the recording's")
    parser.add_argument("--image-topic", metavar="TOPIC", help="image topic of a bag (default /camera/up/image_raw)")
    parser.add_argument(
        "--camera-info-topic", metavar="TOPIC", help="default: camera_info in the namespace of the images"
    )
    parser.add_argument("--exposure-topic", metavar="TOPIC", help="default: exposure in the namespace of the images")
    parser.add_argument("--size", metavar="WxH", help="scale the images down to this size (default: original size)")
    parser.add_argument(
        "--fps", metavar="N", type=float, default=0.0, help="largest number of images used per second (default: all)"
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
    parser.add_argument(
        "--set",
        metavar="key=value",
        dest="overrides",
        action="append",
        default=[],
        help="set one value, such as window.max_keyframes=5 or fusion.graph.window=30; may be repeated",
    )
    parser.add_argument(
        "--predict",
        action="store_true",
        help="predict the motion of the camera from the wheels; useful with few images a second",
    )
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Run odometry and fusion over the whole recording and write the results, also after an error or interruption.

    Raises:
        InputError: wrong settings, unreadable recording, or a folder that cannot be written.
    """
    from tqdm import tqdm

    from ceiling_dso_ros.dso.config import OdometryConfig
    from ceiling_dso_ros.dso.warmup import load_kernels
    from ceiling_dso_ros.fusion.config import FusionConfig
    from ceiling_dso_ros.playback.playback import Playback
    from ceiling_dso_ros.settings import load_settings, write_settings

    if not 0.0 <= options.fps < float("inf"):
        raise InputError(f"--fps {options.fps:g}: 0 or more")
    of_fusion = [text for text in options.overrides if text.startswith(FUSION_PREFIX)]
    of_odometry = [text for text in options.overrides if text not in of_fusion]
    config = load_settings(options.config, of_odometry, OdometryConfig)
    fusion_config = load_settings(
        options.fusion_config, [text[len(FUSION_PREFIX) :] for text in of_fusion], FusionConfig
    )
    recording = _open_recording(options)
    visual = _visual_run(recording, config, options.size)
    fusion = _fusion(recording, fusion_config)
    if options.predict and fusion is None:
        raise InputError(f"{recording.path}: --predict needs wheels and the robot's dimensions")
    with output_folder(options.out) as folder:
        write_settings(folder / "config.yaml", config)
        if fusion is not None:
            write_settings(folder / "fusion.yaml", fusion_config)

    load_kernels(lambda message: print(message, file=sys.stderr))
    playback = Playback(visual, _warn, fusion, options.predict)
    end = "complete"
    try:
        # disable=None: no bar where stderr is no terminal
        total = None if options.fps else len(recording)
        with tqdm(recording.frames(options.fps), total=total, unit="frame", disable=None) as frames:
            playback.play(frames)
    except BaseException as error:
        end = "interrupted" if was_interrupt(error) else f"failed: {type(error).__name__}: {error}"
        raise
    finally:
        playback.write(options.out, end)
        print(_describe(playback.summary(), options.out))


def _open_recording(options: argparse.Namespace) -> "Recording":
    from ceiling_dso_ros.io.opening import open_recording
    from ceiling_dso_ros.io.recording import TopicNames

    topics = {
        "image": options.image_topic,
        "camera_info": options.camera_info_topic,
        "exposure": options.exposure_topic,
    }
    return open_recording(
        options.input,
        TopicNames(**{name: topic for name, topic in topics.items() if topic is not None}),
        camera_file=options.camera,
        robot_file=options.robot,
    )


def _visual_run(recording: "Recording", config: "OdometryConfig", size: Optional[str]) -> "VisualRun":
    """Odometry for the recording's images, scaled if wanted. Called first, so that a wrong size is found early."""
    from ceiling_dso_ros.dso import ConfigError
    from ceiling_dso_ros.io.image_scaling import parse_image_size
    from ceiling_dso_ros.playback.visual_run import VisualRun

    asked_for = None if size is None else parse_image_size(size, "--size")
    try:
        return VisualRun.of(recording, config, size=asked_for)
    except (ConfigError, InputError) as error:
        raise InputError(f"{recording.path}: {error}") from error


def _fusion(recording: "Recording", config: "FusionConfig") -> Optional["FusionPlayback"]:
    """The fusion of a run, None without wheels. Called before the run, so that errors in robot.yaml are found early."""
    from ceiling_dso_ros.dso.config import ConfigError
    from ceiling_dso_ros.playback.fusion_playback import FusionPlayback, robot_model

    robot, wheels = recording.robot, recording.wheels
    if wheels is None:
        return None
    if robot is None:
        _warn(f"{recording.path}: the wheels are not used because the robot's dimensions are unknown; give --robot")
        return None
    try:
        return FusionPlayback(wheels, robot_model(robot), config)
    except ConfigError as error:
        raise InputError(f"{recording.path}: {error}") from error


def _warn(message: str) -> None:
    from tqdm import tqdm

    tqdm.write(f"warning: {message}", file=sys.stderr)


def _describe(summary: dict, directory: Path) -> str:
    segments, mean_ms = summary["segments"], summary["ms"]["all"]["mean"]
    parts = [
        f"{summary['tracked']} of {summary['frames']} frames tracked",
        f"{summary['lost']} lost",
        f"{len(summary['warnings'])} skipped",
        f"{summary['keyframes']} keyframes",
    ]
    if segments > 1:
        parts.append(f"{segments} segments, each with its own unit of length")
    if mean_ms is not None:
        parts.append(f"{mean_ms:.1f} ms a frame")
    return f"{', '.join(parts)}; results in {directory}"
