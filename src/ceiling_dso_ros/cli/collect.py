# SPDX-License-Identifier: BSD-3-Clause
"""`collect`: converts the recorded output of the nodes into trajectories for `evaluate`."""

import argparse
from pathlib import Path

from ceiling_dso_ros.cli.outputs import require_output_folder
from ceiling_dso_ros.cli.recording_options import warn
from ceiling_dso_ros.io.errors import InputError, OutputError

TOPICS = {
    "camera": "/visual_odometry/pose",
    "wheel": "/wheel/odometry",
    "fused": "/odometry/filtered",
    "mapped": "/localization/pose",
}


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "collect",
        help="convert the recorded output of the nodes into trajectories",
        description=f"Write {', '.join(f'{name}.tum' for name in TOPICS)} from a bag with the output of the nodes, for "
        "example from playback.launch record:=BAG; or all trajectories that a node has left that was killed.",
    )
    parser.add_argument("input", metavar="INPUT", type=Path, help="a ROS 1 bag, or the folder of a node: NODE....spool")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder; created if missing")
    for name, topic in TOPICS.items():
        parser.add_argument(f"--{name}-topic", metavar="TOPIC", default=topic, help="default %(default)s")
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Write the trajectories.

    Raises:
        InputError: the input cannot be read or has no poses, or the folder cannot be written to.
        OutputError: some trajectories cannot be written; the others are.
    """
    from ceiling_dso_ros.io.bag_trajectories import pose_topics, read_trajectories
    from ceiling_dso_ros.io.replacing import write_each
    from ceiling_dso_ros.io.trajectory import write_tum
    from ceiling_dso_ros.playback.spool_files import is_spool

    if is_spool(options.input):
        _collect_spool(options.input, options.out)
        return
    if options.input.is_dir():
        raise InputError(_no_spool(options.input))
    topics = {f"{name}.tum": getattr(options, f"{name}_topic") for name in TOPICS}
    require_output_folder(options.out, topics)
    trajectories = read_trajectories(options.input, topics, warn)
    others = [topic for topic in pose_topics(options.input) if topic not in topics.values()]
    elsewhere = f"; it has others on {', '.join(others)}, choose with --fused-topic and its like" if others else ""
    if not trajectories:
        raise InputError(f"{options.input}: no poses on {', '.join(topics.values())}{elsewhere}")
    missing = [name for name in topics if name not in trajectories]
    if others and missing:
        warn(
            f"{options.input}: no {', '.join(missing)}: no poses on {', '.join(topics[n] for n in missing)}{elsewhere}"
        )

    def write(path: Path) -> None:
        trajectory = trajectories[path.name]
        write_tum(path, trajectory)
        print(f"{path}: {len(trajectory)} poses of {topics[path.name]}")

    write_each(options.out, dict.fromkeys(trajectories, write))


def _no_spool(folder: Path) -> str:
    """What is wrong with a folder that is not that of a node."""
    from ceiling_dso_ros.playback.spool_files import is_spool

    inside = sorted(str(path) for path in folder.iterdir() if is_spool(path))
    if inside:
        return f"{folder}: has the results of several runs in it; give one of them: {', '.join(inside)}"
    return f"{folder}: is not the folder of a node, whose name ends with .spool"


def _collect_spool(spool: Path, out: Path) -> None:
    from ceiling_dso_ros.playback.spool_files import write_all

    require_output_folder(out)
    written = write_all(spool, out)
    for name, count in written.poses.items():
        print(f"{out / name}: {count} poses")
    if written.errors:
        raise OutputError(*written.errors)
