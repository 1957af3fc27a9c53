# SPDX-License-Identifier: BSD-3-Clause
"""Options of all commands that track the camera of a recording."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Dict, Optional, Tuple

from ceiling_dso_ros.cli.wheel_options import topics_of_wheels
from ceiling_dso_ros.io.errors import InputError, one_line

if TYPE_CHECKING:
    from ceiling_dso_ros.dso import OdometryConfig
    from ceiling_dso_ros.dso.compute.schedulers import SequentialScheduler
    from ceiling_dso_ros.io.recording import Recording
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.playback.visual_run import VisualRun


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add them, with the recording itself."""
    parser.add_argument("input", metavar="INPUT", type=Path, help="a ROS 1 bag, or a folder in the TUM-mono layout")
    add_camera_options(parser)
    add_exposure_option(parser)
    parser.add_argument(
        "--start", metavar="S", type=float, default=0.0, help="begin so many seconds after the first image"
    )
    parser.add_argument("--duration", metavar="S", type=float, default=0.0, help="use so many seconds (default: all)")


def add_exposure_option(parser: argparse.ArgumentParser) -> None:
    """Add the choice not to use exposure times."""
    parser.add_argument("--no-exposure", action="store_true", help="do not use the exposure times of the recording")


def add_camera_options(parser: argparse.ArgumentParser) -> None:
    """Add those that say where the images are and what they mean."""
    parser.add_argument(
        "--camera", metavar="camera.txt", type=Path, help="calibration to use instead of the recording's"
    )
    parser.add_argument("--image-topic", metavar="TOPIC", help="image topic of a bag (default /camera/up/image_raw)")
    parser.add_argument(
        "--camera-info-topic", metavar="TOPIC", help="default: camera_info in the namespace of the images"
    )
    parser.add_argument("--exposure-topic", metavar="TOPIC", help="default: exposure in the namespace of the images")
    parser.add_argument(
        "--right-image-topic",
        metavar="TOPIC",
        help="images of a second camera, which tells metres (default: /camera/up_right/image_raw where the bag has it; "
        "an empty text to leave them out)",
    )
    parser.add_argument(
        "--rectified", action="store_true", help="the images are rectified: use P of camera_info, not K and D"
    )
    parser.add_argument(
        "--bits",
        metavar="N",
        type=int,
        default=0,
        help="bit depth of 16 bit images, 8 to 16, such as 12 (default: found from the images)",
    )


def add_set_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--set`, into `overrides`; its help begins with what may be set."""
    parser.add_argument(
        "--set", metavar="key=value", dest="overrides", action="append", default=[], help=f"{what}; may be repeated"
    )


def topics_of_camera(options: argparse.Namespace) -> Dict[str, str]:
    """The arguments of TopicNames that were given."""
    topics = {
        "image": options.image_topic,
        "camera_info": options.camera_info_topic,
        "exposure": options.exposure_topic,
        "right_image": options.right_image_topic,
    }
    return {name: topic for name, topic in topics.items() if topic is not None}


def open_with(options: argparse.Namespace, warnings: "WarningLog") -> "Recording":
    """The recording; what is doubtful in it is added to the warnings.

    Raises:
        InputError: it cannot be used, or an option is wrong.
    """
    from ceiling_dso_ros.io.grey_range import check_bits
    from ceiling_dso_ros.io.opening import open_recording
    from ceiling_dso_ros.io.recording import TopicNames

    check_bits(options.bits, "--bits")
    recording = open_recording(
        options.input,
        TopicNames(**topics_of_camera(options), **topics_of_wheels(options)),
        camera_file=options.camera,
        robot_file=getattr(options, "robot", None),
        rectified=options.rectified,
        warn=warnings.add,
    )
    recording.uses_exposures = not options.no_exposure
    return _part(recording, getattr(options, "start", 0.0), getattr(options, "duration", 0.0))


def _part(recording: "Recording", start_s: float, duration_s: float) -> "Recording":
    """The part of a recording that was asked for."""
    from ceiling_dso_ros.io.recording_view import LONGEST_S, RecordingPart

    for name, value_s in (("--start", start_s), ("--duration", duration_s)):
        if not 0.0 <= value_s <= LONGEST_S:
            raise InputError(f"{name} {value_s:g}: 0 to {LONGEST_S:g} seconds")
    if not start_s and not duration_s:
        return recording
    part = RecordingPart(recording, start_s, duration_s)
    if part.is_empty:
        raise InputError(f"{recording.path}: --start {start_s:g}: the last image comes before that")
    return part


def visual_run(
    recording: "Recording",
    config: "OdometryConfig",
    bits: int,
    warnings: "WarningLog",
    scheduler: "Optional[SequentialScheduler]" = None,
    size: Optional[Tuple[int, int]] = None,
) -> "VisualRun":
    """The odometry for the images of a recording; see `VisualRun.of_camera`.

    Raises:
        InputError: images of that size cannot be tracked.
    """
    from ceiling_dso_ros.dso import ConfigError
    from ceiling_dso_ros.playback.visual_run import VisualRun

    try:
        return VisualRun.of(recording, config, scheduler, size, bits, warnings.add)
    except (ConfigError, InputError) as error:
        raise InputError(f"{recording.path}: {error}") from error


def warn(message: str) -> None:
    """Write a warning to stderr, above a progress bar."""
    from tqdm import tqdm

    tqdm.write(one_line(f"warning: {message}"), file=sys.stderr)
