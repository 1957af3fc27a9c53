# SPDX-License-Identifier: BSD-3-Clause
"""`calibrate`: from a recording to the robot's dimensions and the camera's lens."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Iterator, List, Sequence

from ceiling_dso_ros.cli.outputs import require_output_file
from ceiling_dso_ros.cli.recording_options import add_recording_options, add_set_option, open_with, warn
from ceiling_dso_ros.cli.wheel_options import add_wheel_options, require_usable
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.dso import OdometryConfig
    from ceiling_dso_ros.fusion.calibration import CalibratedValue, Calibration
    from ceiling_dso_ros.io.camera_models import CameraCalibration
    from ceiling_dso_ros.io.recording import Frame, Recording
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.lens.calibrating import CameraAndRobot
    from ceiling_dso_ros.lens.observing import ObservedDrive

CAMERA_FILE = "camera.txt"  # beside the robot
LENS_STAYS = "the recording's calibration of the lens fits the images, and stays as it is"


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "calibrate",
        help="estimate the robot's dimensions and the camera's lens from a recording",
        description="Estimate the lens of the camera, its mounting, its time offset, the ratio of the wheel radii and "
        "the wheel base from a recording with camera and wheels. Record one minute with turns in both directions and "
        "straight parts. The height of the camera cannot be estimated and keeps its value, nor can the mean wheel "
        "radius without the images of a second camera. "
        "Writes the robot, and the camera into camera.txt beside it, for --camera of all commands.",
    )
    add_recording_options(parser)
    parser.add_argument("--out", metavar="robot.yaml", type=Path, required=True, help="output file")
    parser.add_argument(
        "--keep-lens", action="store_true", help="the recording's calibration is exact: do not estimate the lens"
    )
    add_set_option(parser, "set one value of the odometry, such as rig.baseline_sigma=0.001")
    add_wheel_options(parser)
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Calibrate, print a table and write the files.

    Raises:
        InputError: unreadable recording, no wheels in it, too little motion, or a file that cannot be written.
        OutputError: the result cannot be written; it is printed.
    """
    from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig
    from ceiling_dso_ros.fusion.calibration import CalibrationError, calibrate
    from ceiling_dso_ros.fusion.config import WheelConfig
    from ceiling_dso_ros.fusion.wheel import WheelOdometry
    from ceiling_dso_ros.io.recording import WheelUnit
    from ceiling_dso_ros.io.replacing import write_each
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.lens.calibrating import calibrate_all
    from ceiling_dso_ros.playback.fusion_playback import robot_model
    from ceiling_dso_ros.playback.wheel_playback import wheel_steps
    from ceiling_dso_ros.settings import load_settings

    inputs = [options.input, options.camera, options.robot]
    require_output_file(options.out, [] if options.keep_lens else [CAMERA_FILE], inputs)
    warnings = WarningLog(warn)
    recording = open_with(options, warnings)
    wheels, description = require_usable(recording)
    if wheels.unit is WheelUnit.POSES:
        warnings.add(
            f"{wheels.source}: the radii and the wheel base are those of the driver of the odometry: correct them there"
        )
    passes = _Passes(recording, load_settings(None, options.overrides, OdometryConfig), options.bits, warnings)
    try:
        robot = robot_model(description)
        steps = list(wheel_steps(wheels, WheelOdometry(robot, WheelConfig())))
        if options.keep_lens:
            drive = passes.observe(recording.calibration)
            calibration = calibrate(steps, drive.poses, robot, drive.scales)
            texts = {options.out.name: _yaml(calibration, options.input)}
        else:
            found = calibrate_all(steps, robot, recording.calibration, passes.observe)
            calibration = found.robot
            texts = {options.out.name: _yaml(calibration, options.input), CAMERA_FILE: _camera(found, options.input)}
    except (ConfigError, CalibrationError) as error:
        raise InputError(f"{options.input}: {error}") from error
    finally:
        warnings.end()
    try:
        write_each(options.out.parent, {name: _writer(text) for name, text in texts.items()})
    finally:
        print(_table([] if options.keep_lens else found.lens_values, calibration.values))
        if not options.keep_lens and found.lens_stays:
            print(LENS_STAYS)
        for line in _left_out(calibration):
            print(line)


class _Passes:
    """Tracks all readable images, with one calibration after another; what is wrong with them is said once."""

    def __init__(self, recording: "Recording", config: "OdometryConfig", bits: int, warnings: "WarningLog") -> None:
        from tqdm import tqdm

        from ceiling_dso_ros.dso.warmup import load_kernels
        from ceiling_dso_ros.lens.warmup import load_kernels as load_kernels_of_lens

        load_kernels(tqdm.write)
        load_kernels_of_lens(tqdm.write)
        self._recording, self._config, self._bits, self._warnings = recording, config, bits, warnings
        self._first = True

    def observe(self, camera: "CameraCalibration") -> "ObservedDrive":
        """One pass."""
        from ceiling_dso_ros.io.warning_log import ignore_warning
        from ceiling_dso_ros.lens.observing import observe
        from ceiling_dso_ros.playback.visual_run import VisualRun

        tell = self._warnings.add if self._first else ignore_warning
        recording = self._recording
        visual = VisualRun.of_camera(
            camera, recording.photometric, config=self._config, bits=self._bits, tell=tell,
            second=recording.second_camera,
        )  # fmt: skip
        drive = observe(visual, self._frames())
        self._first = False
        return drive

    def _frames(self) -> Iterator["Frame"]:
        from tqdm import tqdm

        from ceiling_dso_ros.io.recording import Frame

        recording = self._recording
        listed = recording.frames(wheels=recording.wheels)
        with tqdm(listed, total=len(recording), unit="frame", disable=None) as frames:
            for frame in frames:
                if isinstance(frame, Frame):
                    yield frame
                elif self._first:
                    self._warnings.add(frame.reason, frame.kind)


def _table(of_lens: Sequence["CalibratedValue"], of_robot: Sequence["CalibratedValue"]) -> str:
    from tabulate import tabulate

    from ceiling_dso_ros.fusion.calibration import ALWAYS_UNOBSERVABLE, MEAN_RADIUS

    rows = [[v.name, f"{v.value:.4f}", _sigma(v), v.unit, f"{v.nominal:.4f}"] for v in of_lens]
    rows += [
        [
            value.name,
            f"{value.value:.4f}" if value.excited else "-",
            f"{value.sigma:.4f}" if value.excited else "not determined by the motion",
            value.unit,
            f"{value.nominal:.4f}",
        ]
        for value in of_robot
    ]
    told = {value.name for value in of_robot}
    rows += [
        [name, "-", "cannot be estimated", "m", ""] for name in (ALWAYS_UNOBSERVABLE, MEAN_RADIUS) if name not in told
    ]
    return tabulate(rows, headers=["", "value", "standard deviation", "unit", "before"], disable_numparse=True)


def _sigma(value: "CalibratedValue") -> str:
    """Of a number of the lens; one that the motion does not determine stays about where it was."""
    return f"{value.sigma:.4f}" + ("" if value.excited else ", hardly told by the motion")


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
    lines = [f"calibrated from {source.name} with {calibration.pairs} pairs of images"]
    for value in calibration.values:
        value_found = (
            f"{value.value:.6g} +- {value.sigma:.2g}"
            if value.excited
            else f"not determined by the motion, {value.nominal:.6g} kept"
        )
        lines.append(f"{value.name}: {value_found} {value.unit}".rstrip())
    lines += _left_out(calibration)
    head = "".join(f"# {line}\n" for line in lines)
    return head + yaml.safe_dump(robot_values(description), sort_keys=False)


def _camera(found: "CameraAndRobot", source: Path) -> str:
    """The camera file, with the standard deviation of every value in comments."""
    from ceiling_dso_ros.io.camera_models import camera_file

    camera = found.camera.camera
    lines = [LENS_STAYS if found.lens_stays else f"calibrated from {source.name} in {found.passes} passes"]
    lines += [f"{v.name}: {v.value:.6g} +- {_sigma(v)} {v.unit}".rstrip() for v in found.lens_values]
    return camera_file(found.camera.lens, (camera.width, camera.height), lines)


def _writer(text: str) -> Callable[[Path], None]:
    from ceiling_dso_ros.io.replacing import replace_file

    return lambda path: replace_file(path, text.encode(), "the calibration")
