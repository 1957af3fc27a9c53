# SPDX-License-Identifier: BSD-3-Clause
"""Faults on the live system: a rendered drive through a real roscore and all nodes, one fault at a time.

For each: what must be said, and how soon; the longest silence, the largest jump and the error of the pose, compared
with what the wheels alone have; how many maps are lost, how long it takes until all is well again, and that no node
ends. Needs ROS, a C compiler, and the right to mount (or user name spaces) for full disks. About 30 s for each fault.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Dict, List, Optional

from support.faults.catalogue import FAULTS
from support.faults.drive import rendered
from support.faults.outcome import Fault, Outcome
from support.faults.system import ShiftedClock
from support.ros_processes import Environment, ros_environment
from tabulate import tabulate
from tqdm import tqdm

RUN_FAULT = Path(__file__).parent / "support" / "faults" / "run_fault.py"
TIMEOUT_S = 900.0
HEADERS = (
    "fault",
    "injected",
    "said after, s",
    "silence, s",
    "jump, mm",
    "error, mm",
    "wheels, mm",
    "maps lost",
    "well after, s",
    "holds",
)


def run(name: str, out: Path) -> Outcome:
    """One fault in a process of its own; its logs are in a folder of its name."""
    fault, folder = FAULTS[name], (out / name).resolve()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    rendered(out / "drives", *fault.events)
    environment = _environment(fault, folder)
    if environment is None:
        return Outcome(problems=["no ROS"])
    result = folder / "outcome.json"
    command = [sys.executable, str(RUN_FAULT), name, str(out / "drives"), str(result)]
    with (folder / "script.log").open("w") as log:
        try:
            subprocess.run(
                command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, timeout=TIMEOUT_S
            )
        except subprocess.TimeoutExpired:
            return Outcome(problems=[f"not over after {TIMEOUT_S:g} s"])
    if not result.is_file():
        return Outcome(problems=[f"the script failed, see {folder / 'script.log'}"])
    return Outcome(**json.loads(result.read_text()))


def _environment(fault: Fault, folder: Path) -> Optional[Environment]:
    environment = ros_environment(folder / "log")
    if environment is None:
        return None
    own: Dict[str, str] = {"ROS_HOME": str(folder / "ros_home")}
    own["PYTHONPATH"] = f"{RUN_FAULT.parents[2]}:{environment.get('PYTHONPATH', '')}"
    if fault.shifted_clock:
        own.update(ShiftedClock.prepare(folder))
    if fault.own_kernels:
        own["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    return {**environment, **own}


def row(name: str, outcome: Outcome) -> List[str]:
    """A line of the table."""
    fault = FAULTS[name]
    return [
        name,
        fault.injected,
        _number(outcome.said_after_s, ".1f") if fault.says else "",
        _number(outcome.gap_s, ".2f"),
        "" if fault.begins_anew else _number(outcome.jump_m, ".0f", 1e3),
        "" if fault.begins_anew else _number(outcome.error_m, ".0f", 1e3),
        "" if fault.begins_anew else _number(outcome.wheels_m, ".0f", 1e3),
        str(outcome.losses),
        _number(outcome.recovered_after_s, ".1f"),
        "; ".join(outcome.problems) or "yes",
    ]


def _number(value: Optional[float], style: str, factor: float = 1.0) -> str:
    return "never" if value is None else format(factor * value, style)


def main() -> int:
    """Print one table; 1 when a row does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench faults", description=__doc__)
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/bench/faults"), help="default %(default)s")
    parser.add_argument(
        "--only", nargs="+", choices=FAULTS, default=list(FAULTS), metavar="FAULT", help=", ".join(FAULTS)
    )
    parser.add_argument("--format", default="simple", help="of the table, as tabulate has them; default %(default)s")
    options = parser.parse_args()
    outcomes = {name: run(name, options.out) for name in tqdm(options.only, disable=None)}
    rows = [row(name, outcome) for name, outcome in outcomes.items()]
    print(tabulate(rows, headers=HEADERS, tablefmt=options.format, disable_numparse=True))
    return 0 if all(not outcome.problems for outcome in outcomes.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
