"""Frame times on the shared recordings against their limits: one core, every frame to the end, default settings.

Times are in the unit of `evaluation/machine_speed.py`, measured right before and after each run. Each recording is also
measured with numba restricted to AVX2, which is all that the robot's computer has, with a kernel cache of its own; the
unit stays that of the whole processor.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Dict, Iterator, List, Tuple

import numpy as np
from support.drives import is_missing
from support.table import Row, report

CHECKOUT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("CEILING_DSO_DATA", CHECKOUT.parent / "shared" / "data"))
RECORDINGS = ("ceiling_loops", "tum_fr1_xyz")
LIMITS = {"all": 3.6, "keyframes": 12.0, "others": 1.3}  # a third of the C++ reference's times
LIMITS_AVX2 = {"all": 5.5}
UNIT = "from ceiling_dso_ros.evaluation.machine_speed import machine_ms; print(machine_ms())"


def avx2_environment() -> Dict[str, str]:
    """Of a process whose kernels use no more than AVX2."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    allowed = ",".join(f"{'-' if name.startswith('avx512') else '+'}{name}" for name, on in features.items() if on)
    cache = CHECKOUT / "out" / "numba-avx2"
    return {"NUMBA_CPU_FEATURES": allowed, "NUMBA_CACHE_DIR": str(cache)}


def on_one_core(arguments: List[str], environment: Dict[str, str]) -> str:
    """What a Python process prints that may use the first core only."""
    core = min(os.sched_getaffinity(0))
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, **environment},
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    ).stdout


def unit_ms() -> float:
    """The machine's unit now, on the core that is measured."""
    return float(on_one_core(["-c", UNIT], {}))


def measure(recording: Path, environment: Dict[str, str]) -> Tuple[Dict[str, float], Tuple[float, float]]:
    """Frame times of one run in units by kind, and the unit before and after."""
    with tempfile.TemporaryDirectory() as folder:
        before = unit_ms()
        command = ["-m", "ceiling_dso_ros", "benchmark", str(recording), "--repeats", "1", "--out", folder]
        on_one_core(command, environment)
        units = before, unit_ms()
        result = json.loads((Path(folder) / "benchmark.json").read_text())
    return {kind: ms / np.mean(units) for kind, ms in result["frame_ms"].items()}, units


def rows(recording: Path, runs: int) -> Iterator[Row]:
    """With all that the processor has, and with AVX2 alone."""
    for cpu, environment, limits in (("", {}, LIMITS), (", AVX2", avx2_environment(), LIMITS_AVX2)):
        results = [measure(recording, environment) for _ in range(runs)]
        for kind, limit in limits.items():
            yield Row(recording.name + cpu, f"{kind}, units", [times[kind] for times, _ in results], high=limit)
        yield Row(recording.name + cpu, "unit before and after, ms", [unit for _, units in results for unit in units])


def main() -> int:
    """Entry point; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench speed", description=__doc__)
    parser.add_argument("--runs", metavar="N", type=int, default=3, help="of each recording (default 3)")
    options = parser.parse_args()
    table = [row for name in RECORDINGS if not is_missing(DATA / name) for row in rows(DATA / name, options.runs)]
    print(report(table))
    return 0 if all(row.holds for row in table) else 1


if __name__ == "__main__":
    sys.exit(main())
