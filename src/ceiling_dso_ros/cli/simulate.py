# SPDX-License-Identifier: BSD-3-Clause
"""`simulate`: a simulated drive under a ceiling, as a bag with all sensor data."""

import argparse
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Iterable, Iterator

from ceiling_dso_ros.cli.outputs import complain, require_output_file
from ceiling_dso_ros.io.errors import InputError, OutputError
from ceiling_dso_ros.io.interrupts import deferred_interrupt

if TYPE_CHECKING:
    from tqdm import tqdm

    from ceiling_dso_ros.simulation.config import SimulationConfig
    from ceiling_dso_ros.simulation.recording import SimulatedRecording
    from ceiling_dso_ros.simulation.sensors.measurements import Measurement

EPILOG = """events: slip, lights_off, lights_on, cover, bump, drop_frames, flicker, kidnap; each as
NAME[@START][+DURATION] in seconds. Files beside FILE.bag: FILE.groundtruth.tum (camera), FILE.groundtruth_base.tum,
FILE.truth.yaml (all true values) and FILE.robot.yaml (the nominal robot, for `run --robot`)."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "simulate",
        help="simulate a drive under a ceiling into a bag",
        description="Simulate a robot that drives under a ceiling. Writes a ROS 1 bag with all sensor data, and "
        "files with the true values beside it.",
        epilog=EPILOG,
    )
    parser.add_argument(
        "sequence",
        metavar="SEQUENCE",
        help="square, loops, straight, spin or stop_and_go; with --ceiling random also aisles, eights or weave",
    )
    parser.add_argument("--out", metavar="FILE.bag", type=Path, required=True, help="output bag")
    parser.add_argument(
        "--ceiling",
        metavar="NAME",
        default="factory",
        help="factory, tiles, warehouse, plaster, or random: hall, camera and wheels are drawn by the seed, except for "
        "what is given",
    )
    parser.add_argument(
        "--seed", metavar="N", type=int, default=0, help="seed of all random choices (default %(default)s)"
    )
    parser.add_argument(
        "--session", metavar="N", type=int, default=0, help="the same hall at another time (default %(default)s)"
    )
    parser.add_argument("--duration", metavar="S", type=float, default=0.0, help="seconds (default: one lap)")
    parser.add_argument("--event", metavar="EVENT", action="append", default=[], help="see below; may be repeated")
    _add_camera_options(parser.add_argument_group("camera"))
    _add_wheel_options(parser.add_argument_group("wheels"))
    _add_laser_options(parser.add_argument_group("laser scanner"))
    parser.set_defaults(execute=execute)


def _add_camera_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--size", metavar="WxH", default="848x480", help="pixels (default %(default)s)")
    group.add_argument("--fps", metavar="N", type=float, help="frames a second (default 30)")
    group.add_argument("--read-noise", metavar="X", type=float, help="sensor noise, grey levels (default 0.7)")
    group.add_argument("--shot-noise", metavar="X", type=float, help="photon noise at 255, grey levels (default 1.8)")
    group.add_argument("--response-gamma", metavar="X", type=float, help="1 is linear (default)")
    group.add_argument("--vignette", metavar="X", type=float, help="light lost in the corners, 0 to 0.8 (default 0)")
    group.add_argument("--distortion", metavar="K", type=float, nargs=4, help="k1 k2 p1 p2 of the lens (default: none)")
    group.add_argument("--blur", metavar="PX", type=float, dest="blur_px", help="of the lens, pixels (default 0)")
    group.add_argument("--jpeg", metavar="Q", type=int, dest="jpeg_quality", help="quality, 1 to 100 (default: none)")
    group.add_argument(
        "--lens-error",
        metavar="X",
        type=float,
        nargs=4,
        help="what the calibration in the bag says too much: share of the focal lengths, cx, cy (pixels), k1",
    )
    group.add_argument("--wrong-lens", action="store_true", help="draw the lens error by the seed")
    group.add_argument("--no-exposure", action="store_true", help="the camera does not tell its exposure times")
    group.add_argument(
        "--time-offset", metavar="S", type=float, default=0.0, help="delay of the image stamps, seconds (default 0)"
    )
    group.add_argument("--stereo", action="store_true", help="a second upward camera")
    group.add_argument("--forward", action="store_true", help="a forward-looking camera")
    group.add_argument("--imu", action="store_true", help="an inertial unit")


def _add_wheel_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--radius-error", metavar="X", type=float, dest="radius", help="mean radius, relative (default 0)"
    )
    group.add_argument(
        "--ratio-error", metavar="X", type=float, dest="ratio", help="ratio right/left, relative (default 0.01)"
    )
    group.add_argument("--wheel-base-error", metavar="X", type=float, dest="wheel_base", help="relative (default 0.01)")
    group.add_argument(
        "--travel-noise", metavar="M", type=float, dest="travel_noise_m", help="m after 1 m (default 5e-5)"
    )
    group.add_argument("--tick-noise", metavar="X", type=float, help="reading noise, ticks (default 0.3)")
    group.add_argument("--turn-slip", metavar="X", type=float, help="share of the way, at 1 rad/s (default 0)")


def _add_laser_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--rays", metavar="N", type=int, help="of a scan (default 541)")
    group.add_argument("--range-noise", metavar="M", type=float, dest="range_noise_m", help="metres (default 0.01)")
    group.add_argument(
        "--traffic", metavar="N", type=int, default=0, help="more people and vehicles in the hall (default 0)"
    )


def execute(options: argparse.Namespace) -> None:
    """Write the bag while it is rendered, and the files beside it, also after an interruption.

    Raises:
        InputError: wrong settings, or a folder that cannot be written to.
        OutputError: the bag cannot be written, it is then removed; or some of the files beside it.
    """
    from tqdm import tqdm

    from ceiling_dso_ros.io.bag_writer import BagWriter
    from ceiling_dso_ros.simulation.bag import files_beside, write_measurements
    from ceiling_dso_ros.simulation.config import ConfigError
    from ceiling_dso_ros.simulation.events import EventError
    from ceiling_dso_ros.simulation.recording import SimulatedRecording

    try:
        recording = SimulatedRecording(_config(options))
    except (ConfigError, EventError) as error:
        raise InputError(str(error)) from error
    beside = files_beside(options.out)
    if options.out.is_file() and not beside["truth"].exists():
        raise InputError(f"{options.out}: exists already, and was not simulated; choose another --out")
    require_output_file(options.out, [path.name for path in beside.values()])
    simulation = recording.simulation
    # disable=None: no bar where stderr is no terminal
    with _truth_beside(options.out, recording), BagWriter(options.out) as bag, tqdm(
        total=round(simulation.duration_s, 1), unit="s", disable=None
    ) as progress:
        write_measurements(bag, recording, _shown(simulation.measurements(), progress))
    truth = simulation.truth()
    print(f"{options.out}: {truth['duration_s']:.1f} s, {truth['path_m']:.1f} m, {len(recording)} images")


@contextmanager
def _truth_beside(bag: Path, recording: "SimulatedRecording") -> Iterator[None]:
    """Write the files beside the bag at the end of the block, unless there is no bag.

    Raises:
        OutputError: some cannot be written. After an interruption they are said beside it.
    """
    from ceiling_dso_ros.simulation.bag import write_files_beside

    try:
        yield
    except OutputError:  # an older bag and what is beside it stay
        raise
    except BaseException:
        try:
            with deferred_interrupt():
                write_files_beside(bag, recording)
        except OutputError as error:
            for line in error.lines:
                complain(line)
        raise
    with deferred_interrupt():
        write_files_beside(bag, recording)


def _given(options: argparse.Namespace, kind: type) -> Dict[str, Any]:
    """Attributes of a class of settings that the user has given."""
    values = {field.name: getattr(options, field.name, None) for field in fields(kind)}
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if v is not None}


def _config(options: argparse.Namespace) -> "SimulationConfig":
    from ceiling_dso_ros.io.image_scaling import parse_image_size
    from ceiling_dso_ros.simulation.camera import CameraModel
    from ceiling_dso_ros.simulation.config import SimulationConfig
    from ceiling_dso_ros.simulation.drawn import RANDOM_CEILING, draw_camera, draw_config, draw_lens_error, draw_wheels
    from ceiling_dso_ros.simulation.robot import WheelErrors
    from ceiling_dso_ros.simulation.sensors.laser import LaserModel

    width, height = parse_image_size(options.size, "--size")
    camera = {"width": width, "height": height, **_given(options, CameraModel)}
    if options.wrong_lens:
        camera = {"lens_error": draw_lens_error(options.seed, width), **camera}
    wheels = _given(options, WheelErrors)
    settings: Dict[str, Any] = {
        "session": options.session,
        "duration_s": options.duration,
        "events": tuple(options.event),
        "time_offset_s": options.time_offset,
        "stereo": options.stereo,
        "forward": options.forward,
        "imu": options.imu,
        "laser": LaserModel(**_given(options, LaserModel)),
        "traffic": options.traffic,
    }
    if options.no_exposure:
        settings["exposures_told"] = False
    if options.ceiling != RANDOM_CEILING:
        settings.update(camera=CameraModel(**camera), wheels=WheelErrors(**wheels))
        return SimulationConfig(options.sequence, options.ceiling, options.seed, **settings)
    settings.update(camera=draw_camera(options.seed, **camera), wheels=draw_wheels(options.seed, **wheels))
    return draw_config(options.sequence, options.seed, **settings)


def _shown(measurements: Iterable["Measurement"], progress: "tqdm") -> Iterator["Measurement"]:
    """Yield measurements and move the progress bar to their time."""
    first_ns = None
    for measurement in measurements:
        first_ns = first_ns or measurement.stamp_ns
        progress.update(round((measurement.stamp_ns - first_ns) / 1e9, 1) - progress.n)
        yield measurement
