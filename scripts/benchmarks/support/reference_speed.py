# SPDX-License-Identifier: BSD-3-Clause
"""How long a reference takes, and how much memory."""

import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Iterator

from support.table import Row

from ceiling_dso_ros.experiments.scanned_drive import ScannedDrive
from ceiling_dso_ros.lidar.reference import estimate_reference
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

TIMES_REAL_TIME = 20.0
REPEATS = 2
MEMORY_S = (60.0, 240.0)  # lengths of two drives in the same hall
LARGEST_GROWTH_MB_MIN = 12.0  # of a minute more: its 600 scans alone have 2.6 MB


def speed_rows(config: SimulationConfig) -> Iterator[Row]:
    """Times of one drive, and the largest memory of a short and a long one, each in a process of its own."""
    drive = ScannedDrive(config)
    wheels = drive.wheels
    for words, check_itself in (("with all checks of itself", True), ("without them", False)):
        factors = []
        for repeat in range(REPEATS + 1):
            start = time.process_time()
            estimate_reference(drive.scans, wheels, check_itself=check_itself)
            if repeat:  # the first one compiles
                factors.append(config.duration_s / (time.process_time() - start))
        yield Row(f"{config.duration_s:g} s, 10 Hz, {config.laser.rays} rays", f"times real time, {words}", factors,
                  low=TIMES_REAL_TIME)  # fmt: skip
    largest = [_memory_mb(duration_s) for duration_s in MEMORY_S]
    yield Row("drives of 60 s and 240 s in one hall", "largest memory, MB", largest)
    growth = (largest[1] - largest[0]) / ((MEMORY_S[1] - MEMORY_S[0]) / 60.0)
    yield Row("a minute more in the same hall", "more memory, MB", [growth], LARGEST_GROWTH_MB_MIN)


def _memory_mb(duration_s: float) -> float:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    result = subprocess.run(
        [sys.executable, str(Path(__file__)), str(duration_s)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(result.stdout)


def main() -> None:
    """Print the largest memory of one drive in MB."""
    config = SimulationConfig("loops", seed=100, duration_s=float(sys.argv[1]), laser=LaserModel(1081, 0.02))
    drive = ScannedDrive(config)
    estimate_reference(drive.scans, drive.wheels)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)


if __name__ == "__main__":
    main()
