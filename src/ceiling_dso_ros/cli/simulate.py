# SPDX-License-Identifier: BSD-3-Clause
"""`simulate`: a simulated drive under a ceiling, as a bag with all sensor data."""

import argparse
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Iterable, Iterator

from ceiling_dso_ros.cli.outputs import complain, require_output_file
from ceiling_dso_ros.io.errors import InputError, OutputError
from ceiling_dso_ros.io.interrupts import deferred_interrupt

if TYPE_CHECKING:
    from tqdm import tqdm

    from ceiling_dso_ros.simulation.config import SimulationConfig
    from ceiling_dso_ros.simulation.recording import SimulatedRecording
    from ceiling_dso_ros.simulation.sensors.measurements import Measurement

EPILOG = """events: slip, lights_off, lights_on, cover, bump, drop_frames, flicker; each as
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
    parser.add_argument("sequence", metavar="SEQUENCE", help="square, loops, straight, spin or stop_and_go")
    parser.add_argument("--out", metavar="FILE.bag", type=Path, required=True, help="output bag")
    parser.add_argument("--ceiling", metavar="NAME", default="factory", help="factory, tiles, warehouse or plaster")
    parser.add_argument(
        "--seed", metavar="N", type=int, default=0, help="seed of all random choices (default %(default)s)"
    )
    parser.add_argument("--duration", metavar="S", type=float, default=0.0, help="seconds (default: one lap)")
    parser.add_argument("--event", metavar="EVENT", action="append", default=[], help="see below; may be repeated")
    _add_camera_options(parser.add_argument_group("camera"))
    _add_wheel_options(parser.add_argument_group("wheels"))
    parser.set_defaults(execute=execute)


def _add_camera_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--size", metavar="WxH", default="848x480", help="pixels (default %(default)s)")
    group.add_argument("--fps", metavar="N", type=float, default=30.0, help="frames a second (default %(default)s)")
    group.add_argument(
        "--read-noise", metavar="X", type=float, default=0.7, help="sensor noise, grey levels (default %(default)s)"
    )
    group.add_argument(
        "--shot-noise",
        metavar="X",
        type=float,
        default=1.8,
        help="photon noise at 255, grey levels (default %(default)s)",
    )
    group.add_argument("--response-gamma", metavar="X", type=float, default=1.0, help="1 is linear (default)")
    group.add_argument("--vignette", metavar="X", type=float, default=0.0, help="light lost in the corners, 0 to 0.8")
    group.add_argument("--distortion", metavar="K", type=float, nargs=4, default=(), help="k1 k2 p1 p2 of the lens")
    group.add_argument(
        "--time-offset", metavar="S", type=float, default=0.0, help="delay of the image stamps, seconds (default 0)"
    )
    group.add_argument("--stereo", action="store_true", help="a second upward camera")
    group.add_argument("--forward", action="store_true", help="a forward-looking camera")
    group.add_argument("--imu", action="store_true", help="an inertial unit")


def _add_wheel_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--radius-error", metavar="X", type=float, default=0.0, help="mean radius, relative (default 0)")
    group.add_argument(
        "--ratio-error", metavar="X", type=float, default=0.01, help="ratio right/left, relative (default %(default)s)"
    )
    group.add_argument(
        "--wheel-base-error", metavar="X", type=float, default=0.01, help="relative (default %(default)s)"
    )
    group.add_argument("--travel-noise", metavar="M", type=float, default=5e-5, help="m after 1 m (default 5e-5)")
    group.add_argument(
        "--tick-noise", metavar="X", type=float, default=0.3, help="reading noise, ticks (default %(default)s)"
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
    require_output_file(options.out, [path.name for path in files_beside(options.out).values()])
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


def _config(options: argparse.Namespace) -> "SimulationConfig":
    from ceiling_dso_ros.io.image_scaling import parse_image_size
    from ceiling_dso_ros.simulation.camera import CameraModel
    from ceiling_dso_ros.simulation.config import SimulationConfig
    from ceiling_dso_ros.simulation.robot import WheelErrors

    width, height = parse_image_size(options.size, "--size")
    return SimulationConfig(
        sequence=options.sequence,
        ceiling=options.ceiling,
        seed=options.seed,
        duration_s=options.duration,
        camera=CameraModel(
            width=width,
            height=height,
            fps=options.fps,
            read_noise=options.read_noise,
            shot_noise=options.shot_noise,
            response_gamma=options.response_gamma,
            vignette=options.vignette,
            distortion=tuple(options.distortion),
        ),
        wheels=WheelErrors(
            radius=options.radius_error,
            ratio=options.ratio_error,
            wheel_base=options.wheel_base_error,
            travel_noise_m=options.travel_noise,
            tick_noise=options.tick_noise,
        ),
        events=tuple(options.event),
        time_offset_s=options.time_offset,
        stereo=options.stereo,
        forward=options.forward,
        imu=options.imu,
    )


def _shown(measurements: Iterable["Measurement"], progress: "tqdm") -> Iterator["Measurement"]:
    """Yield measurements and move the progress bar to their time."""
    first_ns = None
    for measurement in measurements:
        first_ns = first_ns or measurement.stamp_ns
        progress.update(round((measurement.stamp_ns - first_ns) / 1e9, 1) - progress.n)
        yield measurement
