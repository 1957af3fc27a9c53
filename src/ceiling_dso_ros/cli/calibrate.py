# SPDX-License-Identifier: BSD-3-Clause
"""`calibrate`: from a recording to the robot's dimensions."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Iterator, List

from ceiling_dso_ros.cli.outputs import require_output_file
from ceiling_dso_ros.cli.recording_options import add_recording_options, open_with, warn
from ceiling_dso_ros.cli.wheel_options import add_wheel_options, require_usable
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.dso import OdometryStatus
    from ceiling_dso_ros.fusion.calibration import Calibration
    from ceiling_dso_ros.io.recording import Recording
    from ceiling_dso_ros.io.warning_log import WarningLog


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "calibrate",
        help="estimate the robot's dimensions from a recording",
        description="Estimate the mounting of the camera, its time offset, the ratio of the wheel radii and the wheel "
        "base from a recording with camera and wheels. Record one minute with turns in both directions and straight "
        "parts. The height of the camera and the mean wheel radius cannot be estimated and keep their values.",
    )
    add_recording_options(parser)
    parser.add_argument("--out", metavar="robot.yaml", type=Path, required=True, help="output file")
    add_wheel_options(parser)
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Calibrate, print a table and write the yaml file.

    Raises:
        InputError: unreadable recording, no wheels in it, too little motion, or a file that cannot be written.
        OutputError: the result cannot be written; it is printed.
    """
    from ceiling_dso_ros.dso.config import ConfigError
    from ceiling_dso_ros.fusion.calibration import CalibrationError, calibrate
    from ceiling_dso_ros.fusion.calibration_data import camera_poses
    from ceiling_dso_ros.fusion.config import WheelConfig
    from ceiling_dso_ros.fusion.wheel import WheelOdometry
    from ceiling_dso_ros.io.recording import WheelUnit
    from ceiling_dso_ros.io.replacing import replace_file
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.playback.fusion_playback import robot_model
    from ceiling_dso_ros.playback.wheel_playback import wheel_steps

    require_output_file(options.out)
    warnings = WarningLog(warn)
    recording = open_with(options, warnings)
    wheels, description = require_usable(recording)
    if wheels.unit is WheelUnit.POSES:
        warnings.add(
            f"{wheels.source}: the radii and the wheel base are those of the driver of the odometry: correct them there"
        )
    try:
        robot = robot_model(description)
        steps = list(wheel_steps(wheels, WheelOdometry(robot, WheelConfig())))
        calibration = calibrate(steps, camera_poses(_track(recording, options.bits, warnings)), robot)
    except (ConfigError, CalibrationError) as error:
        raise InputError(f"{options.input}: {error}") from error
    try:
        replace_file(options.out, _yaml(calibration, options.input).encode(), "the calibration")
    finally:
        print(_table(calibration))
        for line in _left_out(calibration):
            print(line)


def _track(recording: "Recording", bits: int, warnings: "WarningLog") -> Iterator["OdometryStatus"]:
    """Track all readable images; yields their statuses."""
    from tqdm import tqdm

    from ceiling_dso_ros.dso.warmup import load_kernels
    from ceiling_dso_ros.io.recording import Frame
    from ceiling_dso_ros.playback.visual_run import VisualRun

    load_kernels(tqdm.write)
    visual = VisualRun.of(recording, bits=bits, tell=warnings.add)
    with tqdm(recording.frames(wheels=recording.wheels), total=len(recording), unit="frame", disable=None) as frames:
        for frame in frames:
            if isinstance(frame, Frame):
                yield visual.track(frame.image, frame.stamp_ns, frame.exposure_ms).status
            else:
                warnings.add(frame.reason, frame.kind)
    warnings.end()


def _table(calibration: "Calibration") -> str:
    from tabulate import tabulate

    from ceiling_dso_ros.fusion.calibration import ALWAYS_UNOBSERVABLE

    rows = [
        [
            value.name,
            f"{value.value:.4f}" if value.excited else "-",
            f"{value.sigma:.4f}" if value.excited else "not determined by the motion",
            value.unit,
            f"{value.nominal:.4f}",
        ]
        for value in calibration.values
    ]
    rows += [[name, "-", "cannot be estimated", "m", ""] for name in ALWAYS_UNOBSERVABLE]
    return tabulate(rows, headers=["", "value", "standard deviation", "unit", "before"], disable_numparse=True)


def _left_out(calibration: "Calibration") -> List[str]:
    """Lines that name the slips."""
    from ceiling_dso_ros.dso.durations import seconds
    from ceiling_dso_ros.io.stamps import format_stamp

    if not calibration.slips:
        return []
    total = calibration.pairs + calibration.left_out
    lines = [f"{calibration.left_out} of {total} pairs of images are left out, because wheels and camera disagree:"]
    for slip in calibration.slips:
        lines.append(
            f"from {format_stamp(slip.start_ns)} for {seconds(slip.end_ns - slip.start_ns):.1f} s at most: {slip.what}"
        )
    return lines


def _yaml(calibration: "Calibration", source: Path) -> str:
    """The robot file, with the standard deviation of every value in comments."""
    import yaml

    from ceiling_dso_ros.io.recording import RobotDescription
    from ceiling_dso_ros.io.robot_file import robot_values

    robot = calibration.robot
    description = RobotDescription(
        robot.ticks_per_turn,
        robot.wheel_radius_m,
        robot.wheel_base_m,
        robot.T_base_camera,
        robot.camera_time_offset_s,
    )
    lines = [f"# calibrated from {source.name} with {calibration.pairs} pairs of images"]
    for value in calibration.values:
        found = (
            f"{value.value:.6g} +- {value.sigma:.2g}"
            if value.excited
            else f"not determined by the motion, {value.nominal:.6g} kept"
        )
        lines.append(f"# {value.name}: {found} {value.unit}".rstrip())
    lines += [f"# {line}" for line in _left_out(calibration)]
    return "\n".join(lines) + "\n" + yaml.safe_dump(robot_values(description), sort_keys=False)
