# SPDX-License-Identifier: BSD-3-Clause
"""An hour of driving through all nodes, at twice real time, with a fault every minute.

Memory, threads and open files of each node after ten minutes and at the end, the time from a wheel sample to its pose,
the state when no fault has happened for a while, and the error of the pose in sigmas of its covariance. At the end,
fusion_node saves while it goes on, and SIGINT ends all.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List

from support.faults.drive import whole_lap
from support.faults.system import NODES
from support.ros_processes import ros_environment
from support.table import Row, report

RUN_SOAK = Path(__file__).parent / "support" / "faults" / "run_soak.py"
EARLY = 10  # minute from which on nothing may grow
WARM = 5  # minute whose latency is compared with that of the end
MOST_SIGMAS = 4.0
FILES = 6  # camera.tum, camera_final.tum, keyframes.tum, wheel.tum, fused.tum, fused_smoothed.tum
LONGEST_GAP_MS = 50.0  # between two poses while the trajectories are saved
LONGEST_END_S = 15.0  # after which roslaunch kills nodes
SETTLED = 30  # minutes at the end, whose growth is that of all later ones
WEEK = 7 * 24 * 60  # minutes
WEEK_MB = 100.0


def rows(minutes: List[Dict[str, Any]], end: Dict[str, Any]) -> Iterator[Row]:
    """What was measured, with its limits."""
    early, late = minutes[min(EARLY, len(minutes)) - 1], minutes[-1]
    for node in NODES:
        growth = late["resident_mb"][node] / early["resident_mb"][node]
        yield Row(
            node,
            f"memory at the end, MB (minute {EARLY}: {early['resident_mb'][node]:.1f})",
            [late["resident_mb"][node]],
        )
        yield Row(node, "memory at the end / early", [growth], 1.03)
        if len(minutes) > SETTLED + EARLY:
            settled_mb = late["resident_mb"][node] - minutes[-1 - SETTLED]["resident_mb"][node]
            what = f"MB more in a week, as in the last {SETTLED} minutes ({settled_mb:.2f})"
            yield Row(node, what, [settled_mb / SETTLED * WEEK], WEEK_MB)
        yield Row(node, "threads at the end - early", [late["threads"][node] - early["threads"][node]], 0.0)
        yield Row(node, "open files at the end - early", [late["descriptors"][node] - early["descriptors"][node]], 0.0)
    warm = minutes[min(WARM, len(minutes)) - 1]["latency_ms"]
    yield Row(
        "fusion_node", f"latency of a pose, 95 %, ms (minute {WARM}: {warm:.1f})", [late["latency_ms"]], warm + 10.0
    )
    yield Row(
        "fusion_node",
        "share of good states when all is calm, least",
        [min(m["calm_share"] for m in minutes[1:])],
        low=1.0,
    )
    yield Row("fusion_node", "error of the pose at the end, m", [late["error_m"]])
    yield Row(
        "fusion_node", "error in sigmas, largest of all minutes", [max(m["sigmas"] for m in minutes)], MOST_SIGMAS
    )
    poses = end["poses"]
    keyframes = f"{poses.get('fused_smoothed.tum', 0)} keyframes"
    yield Row("fusion_node", "longest time between two poses before it saves, ms", [end["usual_gap_ms"]])
    what = f"the same while it saves {keyframes}, ms ({end['save_s']:.1f} s)"
    yield Row("fusion_node", what, [end["save_gap_ms"]], LONGEST_GAP_MS)
    yield Row("all nodes", "from SIGINT to the end, s", [end["interrupt_s"]], LONGEST_END_S)
    yield Row("all nodes", "files that are left, with poses", [sum(count > 0 for count in poses.values())], low=FILES)


def main() -> int:
    """Print one table; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench soak", description=__doc__)
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/bench/soak"), help="default %(default)s")
    parser.add_argument("--minutes", metavar="N", type=int, default=60, help="of driving; default %(default)s")
    parser.add_argument("--rate", metavar="R", type=float, default=2.0, help="seconds in a second; default %(default)s")
    options = parser.parse_args()
    folder = (options.out / "run").resolve()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    whole_lap(options.out / "drives")
    environment = ros_environment(folder / "log")
    if environment is None:
        return 1
    path = f"{RUN_SOAK.parents[2]}:{environment.get('PYTHONPATH', '')}"
    environment = {**environment, "PYTHONPATH": path, "ROS_HOME": str(folder / "ros_home")}
    result = folder / "minutes.json"
    command = [
        sys.executable,
        str(RUN_SOAK),
        str(options.minutes),
        str(options.rate),
        str(options.out / "drives"),
        str(result),
    ]
    with (folder / "script.log").open("w") as log:
        code = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log).returncode
    if code or not result.is_file():
        print(f"the drive has failed, see {folder}", file=sys.stderr)
        return 1
    measured = json.loads(result.read_text())
    found = list(rows(measured["minutes"], measured["end"]))
    print(report(found))
    return 0 if all(row.holds for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
