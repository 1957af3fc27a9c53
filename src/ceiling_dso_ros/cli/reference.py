# SPDX-License-Identifier: BSD-3-Clause
"""`reference`: from the scans of a 2D LiDAR to a reference trajectory with its uncertainty, and a map."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Dict, List, Optional, Tuple

from ceiling_dso_ros.cli.outputs import require_names_as_text, require_output_file
from ceiling_dso_ros.cli.recording_options import warn
from ceiling_dso_ros.cli.wheel_options import add_wheel_options, topics_of_wheels
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from ceiling_dso_ros.io.bag_contents import BagContents
    from ceiling_dso_ros.io.laser_scans import LaserScans
    from ceiling_dso_ros.io.recording import RobotDescription, TopicNames, WheelSamples
    from ceiling_dso_ros.io.trajectory import Trajectory
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.lidar.reference import Reference
    from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions

EPILOG = """Files beside NAME.tum: NAME.covariance.txt (of each pose), NAME.map.pgm and NAME.map.yaml (for map_server),
NAME.map.png, NAME.trajectory.png, NAME.report.json (how sure it is), and NAME_camera.tum (poses of the upward camera)
where its mount is known."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "reference",
        help="a reference trajectory from the robot's 2D LiDAR",
        description="Estimate where the robot was at each scan of its 2D LiDAR (base_link in map), and how sure that "
        "is. Wheels are used where there are some, but they are not needed.",
        epilog=EPILOG,
    )
    parser.add_argument("input", metavar="INPUT", type=Path, help="a ROS 1 bag, or a log of CARMEN (.log, .clf, .gz)")
    parser.add_argument("--out", metavar="NAME.tum", type=Path, required=True, help="output file")
    parser.add_argument("--scan-topic", metavar="TOPIC", help="topic of the scans (default: /scan, or the only one)")
    parser.add_argument("--laser-frame", metavar="NAME", help="frame of the laser (default: that of the scans)")
    parser.add_argument(
        "--laser-mount",
        metavar=("X", "Y", "YAW"),
        type=float,
        nargs=3,
        help="pose of the laser in the robot's frame, metres and degrees (default: from tf)",
    )
    parser.add_argument(
        "--at",
        metavar="POSES.tum",
        type=Path,
        help="write the poses at the stamps of this file, instead of those of the scans",
    )
    parser.add_argument("--no-wheels", action="store_true", help="do not use the wheels")
    parser.add_argument(
        "--no-self-check", action="store_true", help="do not compare halves of the scans and the way back: faster"
    )
    parser.add_argument(
        "--image-topic", metavar="TOPIC", help="images of the upward camera (default /camera/up/image_raw)"
    )
    add_wheel_options(parser)
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Estimate the trajectory, write it and print how sure it is.

    Raises:
        InputError: unreadable input, no scans that can be used, or files that cannot be written.
        OutputError: some files cannot be written; the others are.
    """
    from ceiling_dso_ros.io.carmen_log import is_carmen_log
    from ceiling_dso_ros.io.replacing import write_each
    from ceiling_dso_ros.io.trajectory import read_tum
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.lidar.reference import estimate_reference
    from ceiling_dso_ros.lidar.warmup import load_kernels

    names = {kind: path.name for kind, path in files_beside(options.out).items()}
    require_names_as_text([options.out, options.input])
    require_output_file(options.out, names.values(), inputs=[options.input, options.at])
    wanted = None if options.at is None else read_tum(options.at)
    warnings = WarningLog(warn)
    if not options.input.exists():
        raise InputError(f"{options.input}: there is no such bag or log")
    read = _read_log if is_carmen_log(options.input) else _read_bag
    scans, wheels, T_base_camera = read(options, warnings)
    load_kernels(warn)
    reference = estimate_reference(scans, wheels, check_itself=not options.no_self_check, warn=warnings.add)
    try:
        write_each(options.out.parent, _writers(options.out, reference, wanted, T_base_camera, warnings))
    finally:
        print(_table(reference))
        print(f"{options.out}: {len(reference.path.stamps_ns) if wanted is None else len(wanted)} poses of base_link")


def files_beside(out: Path) -> Dict[str, Path]:
    """Paths of the files beside the trajectory."""
    endings = {
        "covariances": ".covariance.txt",
        "pgm": ".map.pgm",
        "yaml": ".map.yaml",
        "png": ".map.png",
        "trajectory": ".trajectory.png",
        "report": ".report.json",
        "camera": "_camera.tum",
    }
    return {kind: out.with_name(out.stem + ending) for kind, ending in endings.items()}


Read = Tuple["LaserScans", Optional["WheelMotions"], Optional["np.ndarray"]]


def _read_log(options: argparse.Namespace, warnings: "WarningLog") -> Read:
    from ceiling_dso_ros.io.carmen_log import read_carmen_log
    from ceiling_dso_ros.lidar.scans.wheel_motion import wheel_motions

    log = read_carmen_log(options.input, warnings.add)
    return log.scans, None if options.no_wheels else wheel_motions(log.odometry, None, warnings.add), None


def _read_bag(options: argparse.Namespace, warnings: "WarningLog") -> Read:
    import numpy as np

    from ceiling_dso_ros.fusion import planar
    from ceiling_dso_ros.io.bag_contents import BagContents
    from ceiling_dso_ros.io.bag_scans import read_bag_scans
    from ceiling_dso_ros.io.recording import TopicNames
    from ceiling_dso_ros.lidar.scans.wheel_motion import wheel_motions

    topics = TopicNames(**topics_of_wheels(options), **({"image": options.image_topic} if options.image_topic else {}))
    bag = BagContents(options.input)
    mount = None
    if options.laser_mount is not None:
        x, y, yaw_deg = options.laser_mount
        if not np.isfinite(options.laser_mount).all():
            raise InputError("--laser-mount: the numbers must be finite")
        mount = planar.lift(np.array([x, y, np.radians(yaw_deg)]))
    scans = read_bag_scans(bag, options.scan_topic, topics.base_frame, options.laser_frame, mount, warnings.add)
    robot = _robot(options, bag, topics)
    samples = None if options.no_wheels else _wheels(options, bag, topics, robot, warnings)
    motions = None if samples is None else wheel_motions(samples, robot, warnings.add)
    return scans, motions, _camera_mount(bag, topics) if robot is None else robot.T_base_camera


def _robot(options: argparse.Namespace, bag: "BagContents", topics: "TopicNames") -> "Optional[RobotDescription]":
    """Dimensions from the given file or from NAME.robot.yaml beside the bag; None without either."""
    import numpy as np

    from ceiling_dso_ros.io.robot_file import read_robot_file

    beside = bag.path.with_name(f"{bag.path.stem}.robot.yaml")
    path = options.robot or (beside if beside.exists() else None)

    def mount() -> "np.ndarray":
        found = _camera_mount(bag, topics)
        return np.eye(4) if found is None else found

    return None if path is None else read_robot_file(path, mount)


def _wheels(
    options: argparse.Namespace,
    bag: "BagContents",
    topics: "TopicNames",
    robot: "Optional[RobotDescription]",
    warnings: "WarningLog",
) -> "Optional[WheelSamples]":
    """What the bag has; without dimensions of the robot, its own odometry if there is one."""
    from dataclasses import replace

    from ceiling_dso_ros.io.bag_wheels import BagWheels

    if not topics.wheel_input and robot is None and topics.wheel_odometry in bag.types:
        topics = replace(topics, wheel_input="odometry")
    return BagWheels(bag.path, bag.types, topics, bag.read, warnings.add).read()


def _camera_mount(bag: "BagContents", topics: "TopicNames") -> "Optional[np.ndarray]":
    """T_base_camera from tf; None where there are no images, or tf does not have it."""
    from contextlib import suppress

    from ceiling_dso_ros.io.bag_reader import read_first_and_last
    from ceiling_dso_ros.io.errors import FrameError

    frame = topics.camera_frame
    for topic in (topics.image, f"{topics.image}/compressed"):
        for raw in read_first_and_last(bag.path, topic, 1) if not frame else ():
            with suppress(FrameError, AttributeError):
                frame = frame or str(raw.content().header.frame_id).strip("/")
    return bag.find_transform(topics.base_frame, frame)[0] if frame else None


def _writers(
    out: Path,
    reference: "Reference",
    wanted: "Optional[Trajectory]",
    T_base_camera: "Optional[np.ndarray]",
    warnings: "WarningLog",
) -> Dict[str, Callable[[Path], object]]:
    from ceiling_dso_ros.io.pose_covariances import PoseCovariances, write_covariances
    from ceiling_dso_ros.io.replacing import replace_file
    from ceiling_dso_ros.io.trajectory import write_tum
    from ceiling_dso_ros.lidar.rendering import draw_map, draw_trajectory

    stamps_ns = None if wanted is None else wanted.stamps_ns
    report = {**reference.numbers(), "input_warnings": warnings.lines}
    numbers = (json.dumps(report, indent=2, allow_nan=False) + "\n").encode()
    image = draw_map(reference)
    names = {kind: path.name for kind, path in files_beside(out).items()}
    covariances = PoseCovariances(reference.path.stamps_ns, reference.covariances)
    writers: Dict[str, Callable[[Path], object]] = {
        out.name: lambda path: write_tum(path, reference.trajectory(stamps_ns)),
        names["covariances"]: lambda path: write_covariances(path, covariances),
        names["pgm"]: lambda path: replace_file(path, image.pgm(), "the map"),
        names["yaml"]: lambda path: replace_file(path, image.yaml(names["pgm"]), "the map"),
        names["png"]: lambda path: replace_file(path, image.png(), "the map"),
        names["trajectory"]: lambda path: replace_file(path, draw_trajectory(reference, image), "the picture"),
        names["report"]: lambda path: replace_file(path, numbers, "the report"),
    }
    if T_base_camera is not None:
        writers[names["camera"]] = lambda path: write_tum(path, reference.trajectory(stamps_ns, T_base_camera))
    return writers


def _table(reference: "Reference") -> str:
    """How sure the trajectory is."""
    from tabulate import tabulate

    numbers: Dict[str, Any] = reference.numbers()
    sigma, loops, corridor = numbers["sigma"], numbers["loops"], numbers["corridor"]
    rows: List[Tuple[str, str]] = [
        (
            "scans",
            f"{numbers['scans']} in {numbers['duration_s']:.1f} s, {100 * numbers['valid_rays']:.0f} % valid rays",
        ),
        ("way", f"{numbers['path_m']:.2f} m"),
        ("scans without a match", str(numbers["scans_without_match"])),
        ("keyframes, landmarks", f"{numbers['keyframes']}, {numbers['landmarks']}"),
        ("loops", f"{loops['found']}, {loops['right']} of them right"),
        ("noise of the ranges", f"{1e3 * numbers['range_sigma_m']:.1f} mm"),
        (
            "standard deviation of the position",
            f"{1e3 * sigma['position_rms_m']:.1f} mm rms, {1e3 * sigma['position_max_m']:.1f} mm at most",
        ),
        ("of the yaw", f"{sigma['yaw_rms_deg']:.3f} degrees rms, {sigma['yaw_max_deg']:.3f} at most"),
        ("scans in a corridor", f"{corridor['scans']}, smallest ratio {corridor['smallest_eigenvalue_ratio']:.2g}"),
    ]
    for name, key in (("odd against even scans", "odd_against_even"), ("backwards", "backwards_against_forwards")):
        found = numbers[key]
        if found is not None:
            rows.append((name, f"{1e3 * found['position_m']:.1f} mm, {_degrees(found['yaw_rad']):.3f} degrees"))
    return tabulate(rows, tablefmt="plain", disable_numparse=True)


def _degrees(angle_rad: float) -> float:
    import math

    return math.degrees(angle_rad)
