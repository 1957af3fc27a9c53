# SPDX-License-Identifier: BSD-3-Clause
"""`collect`: converts the recorded output of the nodes into trajectories for `evaluate`."""

import argparse
from pathlib import Path

from ceiling_dso_ros.cli.output_folder import output_folder
from ceiling_dso_ros.cli.recording_options import warn
from ceiling_dso_ros.io.errors import InputError, OutputError

TOPICS = {"camera": "/visual_odometry/pose", "wheel": "/wheel/odometry", "fused": "/odometry/filtered"}


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "collect",
        help="convert the recorded output of the nodes into trajectories",
        description="Write camera.tum, wheel.tum and fused.tum from a bag with the output of the nodes, for example "
        "from playback.launch record:=BAG.",
    )
    parser.add_argument("bag", metavar="BAG", type=Path, help="a ROS 1 bag")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder; created if missing")
    for name, topic in TOPICS.items():
        parser.add_argument(f"--{name}-topic", metavar="TOPIC", default=topic, help="default %(default)s")
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Write the trajectories.

    Raises:
        InputError: the bag cannot be read or has none of the topics, or the folder cannot be written.
    """
    from ceiling_dso_ros.io.bag_trajectories import read_trajectories
    from ceiling_dso_ros.io.trajectory import write_tum

    topics = {name: getattr(options, f"{name}_topic") for name in TOPICS}
    trajectories = read_trajectories(options.bag, topics, warn)
    if not trajectories:
        raise InputError(f"{options.bag}: no poses on {', '.join(topics.values())}")
    try:
        with output_folder(options.out) as folder:
            for name, trajectory in trajectories.items():
                write_tum(folder / f"{name}.tum", trajectory)
    except OutputError as error:
        raise InputError(str(error)) from error
    for name, trajectory in trajectories.items():
        print(f"{options.out / name}.tum: {len(trajectory)} poses of {topics[name]}")
