# SPDX-License-Identifier: BSD-3-Clause
"""The RealSense driver with simulated cameras: errors of its stamps, its share of a core, and whether it grows.

Two simulated hours of stamps by each distribution of delays; realsense_node at 848x480 and 30 Hz, with a subscriber;
and as many images as two hours have, small ones, as fast as they come.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
import xmlrpc.client
from contextlib import suppress
from pathlib import Path
from typing import Dict, Iterator, List

import numpy as np
from support.checkout import CHECKOUT
from support.memory import resident_mb
from support.ros_processes import ros_environment, running
from support.table import Row, report

from ceiling_dso_ros.drivers.camera_process import CameraProcess
from ceiling_dso_ros.drivers.reports import CapturedImages, Report
from ceiling_dso_ros.drivers.settings import CameraSettings, Mode
from ceiling_dso_ros.drivers.stamping import ImageStamper

DRIVERS = CHECKOUT / "test" / "drivers"
STAND_IN = DRIVERS / "stand_in"
sys.path.insert(0, str(DRIVERS))

from fake_bench import FakeBench  # noqa: E402
from test_device_clock import DELAYS, RATE_HZ, Device  # noqa: E402

HOURS_S = 7200.0
SETTLING_S = 10.0
LIMIT_MS, LIMIT_CORE_PERCENT, LIMIT_GROWTH = 0.5, 10.0, 1.03
TICK_HZ = os.sysconf("SC_CLK_TCK")
EARLY_SHARE = 0.1  # of the images, from which on nothing may grow


def clock_rows() -> Iterator[Row]:
    """Errors of stamps whose truth is known."""
    for name, delay in DELAYS.items():
        errors_ms = [1e-6 * Device(drift, 2**32 - 20_000_000, delay).run(0.0, HOURS_S) for drift in (-50.0, 50.0)]
        first, rest = (np.concatenate([e[part] for e in errors_ms]) for part in _parts())
        subject = f"delay {name}, drift -50, 50 ppm"
        yield Row(subject, "largest error after 10 s, ms", [np.abs(rest).max()], LIMIT_MS)
        yield Row(subject, "standard deviation, ms", [rest.std()])
        yield Row(subject, "largest error before, ms", [np.abs(first).max()])


def _parts() -> List[slice]:
    split = round(SETTLING_S * RATE_HZ)
    return [slice(RATE_HZ, split), slice(split, None)]  # images of the first second are not published


def growth_rows(bench: FakeBench, images: int) -> Iterator[Row]:
    """Memory and open files of this process and the streaming one, over a number of images."""
    bench.plug_in(modes=[[160, 120, 5000]])
    stamper, seen, memory_mb = ImageStamper(), 0, []

    def take(report: Report) -> None:
        nonlocal seen
        if isinstance(report, CapturedImages):
            stamper.stamp(report)
            seen += 1

    process = CameraProcess(CameraSettings(mode=Mode(160, 120, 5000)), take)
    process.start()
    start_s = time.monotonic()
    for goal in (EARLY_SHARE * images, images):
        while seen < goal:
            time.sleep(0.05)
        memory_mb.append((resident_mb(), _resident_mb(process.pid or 0)))
    duration_s = time.monotonic() - start_s
    process.close()
    bench.unplug()
    for name, early, late in zip(("using", "streaming"), *memory_mb):
        yield Row(f"{name} process", f"MB after {images} images ({duration_s:.0f} s)", [late])
        yield Row(f"{name} process", "memory at the end / early", [late / early], LIMIT_GROWTH)


def _resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6


def node_rows(bench: FakeBench, duration_s: float, out: Path) -> Iterator[Row]:
    """The share of a core that the node and its streaming process take."""
    environment = ros_environment(out / "log")
    if environment is None:
        return
    path = f"{STAND_IN}:{environment.get('PYTHONPATH', '')}"
    environment = {**environment, "PYTHONPATH": path, "FAKE_REALSENSE": str(bench.folder)}
    bench.plug_in(jitter_ms=5.0)
    port = environment["ROS_MASTER_URI"].rpartition(":")[2]
    launch = ["roslaunch", "-p", port, "ceiling_dso_ros", "realsense.launch"]
    listen = ["rostopic", "hz", "/camera/up/image_raw"]
    with (out / "node.log").open("w") as log, running(launch, environment, log):
        node = _pid(environment["ROS_MASTER_URI"])
        with running(listen, environment, log):
            time.sleep(10.0)
            pids = {"realsense_node": node, "streaming process": _children(node)[0]}
            before_s = {name: _cpu_s(pid) for name, pid in pids.items()}
            time.sleep(duration_s)
            share = {name: 100.0 * (_cpu_s(pid) - before_s[name]) / duration_s for name, pid in pids.items()}
    bench.unplug()
    yield from _share_rows(share)


def _share_rows(share: Dict[str, float]) -> Iterator[Row]:
    for name, percent in share.items():
        yield Row(name, "share of a core at 848x480, 30 Hz, %", [percent])
    yield Row("both", "share of a core at 848x480, 30 Hz, %", [sum(share.values())], LIMIT_CORE_PERCENT)


def _pid(uri: str) -> int:
    """Of the node, once it has begun."""
    while True:
        time.sleep(0.5)
        with suppress(OSError):  # there is no master yet
            known, _, node = xmlrpc.client.ServerProxy(uri).lookupNode("/bench", "/realsense_node")  # type: ignore[misc]
            if known == 1:
                return int(xmlrpc.client.ServerProxy(str(node)).getPid("/bench")[2])  # type: ignore[index, arg-type]


def _children(pid: int) -> List[int]:
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / TICK_HZ


def main() -> int:
    """Print one table; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench realsense", description=__doc__)
    parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("out/bench/realsense"), help="default %(default)s"
    )
    parser.add_argument("--seconds", metavar="S", type=float, default=60.0, help="of the node; default %(default)s")
    parser.add_argument(
        "--images", metavar="N", type=int, default=216_000, help="that may not grow; default %(default)s"
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp())
    bench = FakeBench(folder / "bench")
    os.environ["FAKE_REALSENSE"] = str(bench.folder)
    sys.path.insert(0, str(STAND_IN))  # for the streaming process, which takes over the path
    try:
        found = [*clock_rows(), *node_rows(bench, options.seconds, options.out), *growth_rows(bench, options.images)]
    finally:
        shutil.rmtree(folder)
    print(report(found))
    return 0 if all(row.holds for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
