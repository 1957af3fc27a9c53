# SPDX-License-Identifier: BSD-3-Clause
"""`map`: a map of a site from recordings, where a recording is in it, and what it shows."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, List

from ceiling_dso_ros.cli.outputs import require_output_file, require_output_folder
from ceiling_dso_ros.cli.recording_options import add_camera_options, add_exposure_option, open_with, visual_run, warn
from ceiling_dso_ros.cli.wheel_options import add_wheel_options, require_usable
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    from ceiling_dso_ros.playback.mapping import DriveInMap, MappedDrive
    from ceiling_dso_ros.slam.site_map import SiteMap

FIGURE_ENDINGS = (".png", ".svg")


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command with its own commands."""
    parser = commands.add_parser(
        "map",
        help="build a map of a site, and find recordings in it",
        description="A map of a site, in which a robot is found again. See docs/map.md.",
    )
    own = parser.add_subparsers(metavar="COMMAND", required=True)
    build = own.add_parser(
        "build",
        help="build a map from recordings of one robot",
        description="Build a map from recordings of one robot with wheels. The first one begins the map; each further "
        "one is joined where it comes to a place that is known already.",
    )
    build.add_argument("inputs", metavar="RECORDING", type=Path, nargs="+", help="bag or folder, as `run` takes them")
    build.add_argument("--out", metavar="SITE", type=Path, required=True, help="file of the map")
    build.set_defaults(execute=_build)
    localise = own.add_parser(
        "localise",
        help="find a recording in a map",
        description="Find a recording in a map without a first guess. Writes mapped.tum (base_link in map, from when "
        "it was found on, without later information) and localisation.json into DIR.",
    )
    localise.add_argument("input", metavar="RECORDING", type=Path, help="bag or folder, as `run` takes them")
    localise.add_argument("--map", metavar="SITE", type=Path, required=True, help="file of the map")
    localise.add_argument("--out", metavar="DIR", type=Path, required=True, help="output folder; created if missing")
    localise.set_defaults(execute=_localise)
    for command in (build, localise):
        add_camera_options(command)
        add_exposure_option(command)
        add_wheel_options(command)
    info = own.add_parser("info", help="say what is in a map, and draw it")
    info.add_argument("map", metavar="SITE", type=Path, help="file of the map")
    info.add_argument(
        "--picture", metavar="FILE", type=Path, help="draw the ceiling, the ways and the loops: .png or .svg"
    )
    info.add_argument(
        "--way", metavar="TUM", type=Path, action="append", default=[], help="draw a mapped.tum, too; may be repeated"
    )
    info.set_defaults(execute=_info)


def _build(options: argparse.Namespace) -> None:
    from ceiling_dso_ros.playback.mapping import build
    from ceiling_dso_ros.slam.builder import SiteBuilder
    from ceiling_dso_ros.slam.map_file import write_map

    require_output_file(options.out, inputs=options.inputs)
    builder, refused = None, 0
    for path in options.inputs:
        drive = _drive(path, options)
        if builder is None:
            builder, camera = SiteBuilder(drive.camera), drive.camera
        elif not camera.same_as(drive.camera):
            raise InputError(f"{path}: another camera or mount than that of {options.inputs[0]}")
        else:
            builder.begin_session()
        refused += sum(not decision.accepted for decision in build(builder, drive))
        if not builder.is_placed:
            warn(f"{path}: never came to a place that is known already; it is left out")
    assert builder is not None
    site = builder.site()
    write_map(options.out, site)
    print(f"{options.out}: {_described(site)}, {refused} comparisons refused")


def _localise(options: argparse.Namespace) -> None:
    from ceiling_dso_ros.io.replacing import replace_file
    from ceiling_dso_ros.io.trajectory import write_tum
    from ceiling_dso_ros.playback.mapping import localise
    from ceiling_dso_ros.slam.map_file import read_map, require_camera

    site = read_map(options.map)
    require_output_folder(options.out, ["mapped.tum", "localisation.json"])
    drive = _drive(options.input, options)
    require_camera(options.map, site, drive.camera)
    found = localise(site, drive)
    write_tum(options.out / "mapped.tum", found.trajectory(drive.fused))
    text = json.dumps(_summary(found), indent=2)
    replace_file(options.out / "localisation.json", f"{text}\n".encode(), "the summary")
    if found.first_m is None:
        print(f"{options.input}: was not found in {options.map}; results in {options.out}")
    else:
        print(f"{options.input}: found after {found.first_m:.2f} m; results in {options.out}")


def _summary(found: "DriveInMap") -> dict:
    return {
        "localised_after_m": found.first_m,
        "keyframes": len(found.states),
        "states": [state.value for state in found.states],
    }


def _info(options: argparse.Namespace) -> None:
    from ceiling_dso_ros.evaluation.map_figure import write_map_figure
    from ceiling_dso_ros.io.trajectory import read_tum
    from ceiling_dso_ros.slam.map_file import read_map

    picture = options.picture
    if options.way and picture is None:
        raise InputError(f"--way {options.way[0]}: is drawn in a picture; name its file with --picture")
    if picture is not None and picture.suffix not in FIGURE_ENDINGS:
        raise InputError(f"--picture {picture}: must end with {' or '.join(FIGURE_ENDINGS)}")
    if picture is not None:
        require_output_file(picture, inputs=[options.map, *options.way])
    site = read_map(options.map)
    print(f"{options.map}: {_described(site)}")
    own = site.camera.camera
    print(f"camera: {own.width}x{own.height}, fx {own.fx:.2f} px; ceiling: {_heights(site)}")
    if picture is not None:
        write_map_figure(picture, site, {path.stem: read_tum(path, warn).positions for path in options.way})


def _heights(site: "SiteMap") -> str:
    heights: List[float] = [keyframe.record.height_m for keyframe in site.keyframes]
    return f"{min(heights):.1f} to {max(heights):.1f} m above the floor" if heights else "nothing seen"


def _described(site: "SiteMap") -> str:
    loops = sum(edge.is_loop for edge in site.edges)
    x, y = site.size_m
    return f"{len(site.keyframes)} keyframes of {site.sessions} drives in {x:.1f} x {y:.1f} m, {loops} loops"


def _drive(path: Path, options: argparse.Namespace) -> "MappedDrive":
    """Track a recording with its wheels.

    Raises:
        InputError: it cannot be used, has no wheels, or gives no metric poses.
    """
    from tqdm import tqdm

    from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig
    from ceiling_dso_ros.io.warning_log import WarningLog
    from ceiling_dso_ros.playback.fusion_playback import FusionPlayback, robot_model
    from ceiling_dso_ros.playback.mapping import MappedDrive
    from ceiling_dso_ros.playback.playback import Playback

    warnings = WarningLog(warn)
    options.input = path
    recording = open_with(options, warnings)
    wheels, robot = require_usable(recording)
    visual = visual_run(recording, OdometryConfig(), options.bits, warnings)
    try:
        fusion = FusionPlayback(wheels, robot_model(robot), warn=warnings.add)
    except ConfigError as error:
        raise InputError(f"{path}: {error}") from error
    playback = Playback(visual, warnings, fusion, keep_keyframes=True)
    with tqdm(
        recording.frames(wheels=wheels), total=len(recording), unit="frame", desc=path.name, disable=None
    ) as frames:
        playback.play(frames)
    warnings.end()
    return MappedDrive.of(playback, fusion, path)
