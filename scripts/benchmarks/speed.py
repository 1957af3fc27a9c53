# SPDX-License-Identifier: BSD-3-Clause
"""Frame times and latency against their limits: of the shared recordings, and of a simulated drive in real time.

Recordings run on one core with default settings, and every frame is processed completely. Times are in the unit of
`evaluation/machine_speed.py`, measured right before and after each run. Each recording is also measured with numba
restricted to AVX2, which is all that the robot's computer has, with a kernel cache of its own; the unit is still that
of the whole processor. The drive, `loops` on `factory` at 848x480 and 30 Hz, plays in real time with the mapping beside
the tracking, on two cores; its bag stays in the folder. It also plays through the nodes, on a roscore of its own, with
the fusion beside the odometry, on all cores: the latency is from an image's stamp to its published pose, in wall time.
The last parts have no limits and run on one core: how the times grow with points, window and image size (a table, and
growth.svg in the folder), and how far the kernels are from the processor's limits.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import numpy as np
from support.checkout import CHECKOUT, DATA
from support.growth import USUAL, describe, measure_growth, write_figure
from support.node_latency import play
from support.ros_processes import ros_environment
from support.table import Row, report

from ceiling_dso_ros.experiments.kept_runs import is_missing
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrive, RenderedDrives
from ceiling_dso_ros.simulation.bag import files_beside
from ceiling_dso_ros.simulation.config import SimulationConfig

BOUNDS = Path(__file__).parent / "support" / "bounds.py"
RECORDINGS = ("ceiling_loops", "tum_fr1_xyz")
LIMITS = {"all": 3.6, "keyframes": 12.0, "others": 1.3}  # a third of the C++ reference's times
LIMITS_AVX2 = {"all": 5.5}
MEMORY_MB = 500.0
SPEED_FACTORS = {15: 2.0, 7: 4.0}  # at least, by keyframes in the window: possible frame rate over that of the drive
LATENCY_MS = {"median": (50.0, 15.0), "p95": (95.0, 40.0)}  # percentile and limit
DROPPED_PERCENT = 1.0
DRIVE = SimulationConfig("loops", "factory")
UNIT = "from ceiling_dso_ros.playback.machine_speed import machine_ms; print(machine_ms())"


def avx2_environment() -> Dict[str, str]:
    """Environment of a process whose kernels use AVX2 at most."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    allowed = ",".join(f"{'-' if name.startswith('avx512') else '+'}{name}" for name, on in features.items() if on)
    cache = CHECKOUT / "out" / "numba-avx2"
    return {"NUMBA_CPU_FEATURES": allowed, "NUMBA_CACHE_DIR": str(cache)}


def on_cores(count: int, arguments: List[str], environment: Dict[str, str]) -> str:
    """Output of a Python process that may use the given number of cores."""
    cores = sorted(os.sched_getaffinity(0))[:count]
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, **environment},
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    ).stdout


def as_options(*settings: str) -> List[str]:
    """Settings, key=value, as arguments of a command."""
    return [word for text in settings for word in ("--set", text)]


def unit_ms() -> float:
    """The machine's unit now, on the core that is measured."""
    return float(on_cores(1, ["-c", UNIT], {}))


def benchmark(source: Path, cores: int, environment: Dict[str, str], *options: str) -> Dict[str, Any]:
    """Run the command `benchmark`; returns its result."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["-m", "ceiling_dso_ros", "benchmark", str(source), "--out", folder, *options]
        on_cores(cores, command, environment)
        return json.loads((Path(folder) / "benchmark.json").read_text())


def measure(recording: Path, environment: Dict[str, str]) -> Tuple[Dict[str, float], float, Tuple[float, float]]:
    """Measure one run: frame times in units by kind, peak memory in MB, and the unit before and after."""
    before = unit_ms()
    result = benchmark(recording, 1, environment, "--repeats", "1", *as_options(*USUAL))
    units = before, unit_ms()
    times = {kind: ms / float(np.mean(units)) for kind, ms in result["frame_ms"].items()}
    return times, result["peak_memory_mb"], units


def recording_rows(recording: Path, runs: int) -> Iterator[Row]:
    """Rows of a recording with all instructions of the processor, and with AVX2 alone."""
    for cpu, environment, limits in (("", {}, LIMITS), (", AVX2", avx2_environment(), LIMITS_AVX2)):
        subject = recording.name + cpu
        results = [measure(recording, environment) for _ in range(runs)]
        for kind, limit in limits.items():
            yield Row(subject, f"{kind}, units", [times[kind] for times, _, _ in results], high=limit)
        yield Row(subject, "peak memory, MB", [memory for _, memory, _ in results], high=MEMORY_MB)
        yield Row(subject, "unit before and after, ms", [unit for _, _, units in results for unit in units])


def live_rows(bag: Path, runs: int) -> Iterator[Row]:
    """Rows of the drive in real time, with windows of two lengths."""
    for keyframes, least in SPEED_FACTORS.items():
        subject = f"{bag.stem}, live, window {keyframes}"
        settings = as_options(*USUAL, f"window.max_keyframes={keyframes}")
        results = [benchmark(bag, 2, {}, "--live", "1", *settings) for _ in range(runs)]
        yield Row(subject, "speed factor", [result["speed_factor"] for result in results], low=least)
        yield Row(subject, "images dropped while tracking", [result["dropped"] for result in results], high=0)
        for name in ("median", "p95"):
            yield Row(subject, f"latency, {name}, ms", [result["latency_ms"][name] for result in results])


def node_rows(drive: RenderedDrive, runs: int, logs: Path) -> Iterator[Row]:
    """Rows of the drive through the nodes in real time; without ROS a message and no rows.

    Args:
        drive: what is played.
        runs: how often.
        logs: folder for what the nodes write.
    """
    environment = ros_environment(logs)
    if environment is None:
        return
    subject = f"{drive.name}, nodes"
    results = [play(drive.bag, files_beside(drive.bag)["robot"], environment) for _ in range(runs)]
    for name, (percentile, limit) in LATENCY_MS.items():
        yield Row(subject, f"latency, {name}, ms", [heard.latency_ms(percentile) for heard in results], high=limit)
    dropped = [heard.dropped_percent() for heard in results]
    yield Row(subject, "images dropped after the first pose, %", dropped, high=DROPPED_PERCENT)


def recordings(options: argparse.Namespace) -> Iterator[Row]:
    """Frame times of the shared recordings, on one core."""
    for name in RECORDINGS:
        if not is_missing(DATA / name):
            yield from recording_rows(DATA / name, options.runs)


def live(options: argparse.Namespace) -> Iterator[Row]:
    """The drive in real time, in one process."""
    yield from live_rows(drives(options).drive(DRIVE).bag, options.runs)


def nodes(options: argparse.Namespace) -> Iterator[Row]:
    """The drive in real time, through the nodes."""
    yield from node_rows(drives(options).drive(DRIVE), options.runs, options.out / "ros")


def growth(options: argparse.Namespace) -> Iterator[Row]:
    """Print how times grow and draw it; no limits."""
    found = measure_growth(drives(options), one_run)
    write_figure(options.out / "growth.svg", found)
    print(describe(found), end="\n\n")
    yield from ()


def bounds(options: argparse.Namespace) -> Iterator[Row]:
    """Print what bounds the kernels; no limits."""
    print(on_cores(1, [str(BOUNDS), str(drives(options).drive(DRIVE).bag)], {}))
    yield from ()


def drives(options: argparse.Namespace) -> RenderedDrives:
    """Where the simulated drives are."""
    return RenderedDrives(options.out / "drives")


def one_run(bag: Path, *settings: str) -> Dict[str, Any]:
    """Result of the command `benchmark` for one run on one core."""
    return benchmark(bag, 1, {}, "--repeats", "1", *as_options(*settings))


PARTS = {part.__name__: part for part in (recordings, live, nodes, growth, bounds)}


def main() -> int:
    """Entry point; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench speed", description=__doc__)
    parser.add_argument("--runs", metavar="N", type=int, default=3, help="of each recording (default 3)")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("out/bench/speed"), help="for the drives (default %(default)s)"
    )
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART", help=", ".join(PARTS))
    options = parser.parse_args()
    table = [row for name, part in PARTS.items() if name in options.only for row in part(options)]
    print(report(table))
    return 0 if all(row.holds for row in table) else 1


if __name__ == "__main__":
    sys.exit(main())
