#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Compares the poses published by the nodes with the wheels alone: scripts/demo_report.py DIR, after `evaluate DIR`.

Prints a table and writes DIR/report.md with the figures; exits with 1 when the fused odometry is worse, or the robot
was not found in the map.
"""

import json
import sys
from pathlib import Path
from typing import Dict, List

import numpy as np
from tabulate import tabulate

from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.evaluation.association import interpolate_poses
from ceiling_dso_ros.evaluation.errors import distance_travelled_m, position_errors
from ceiling_dso_ros.evaluation.report import evaluate_trajectory
from ceiling_dso_ros.io.trajectory import read_tum

HEADERS = ["trajectory", "poses", "ATE rmse [m]", "largest [m]", "of the way [%]", "rotation rmse [deg]"]
NAMES = {"wheel": "wheels alone", "camera": "camera alone, after scaling", "fused": "fused"}


def row(label: str, numbers: Dict) -> List:
    """One line of the table."""
    ate_m = numbers["ate_m"]
    percent = 100.0 * ate_m["rmse"] / numbers["path_m"]
    return [label, numbers["poses"], ate_m["rmse"], ate_m["max"], percent, numbers["rotation_deg"]["rmse"]]


def found_in_map(directory: Path) -> str:
    """Where the robot of the second drive was found: in words, empty if it was not.

    The map lies in the hall where the first drive's poses fit its true ones best.
    """
    again = directory / "again"
    if not (again / "mapped.tum").exists():
        return ""
    first, truth = read_tum(directory / "fused.tum"), read_tum(directory / "drive.groundtruth_base.tum")
    map_in_hall = evaluate_trajectory("fused", first, truth, AlignmentKind.SE2, 0.01, interpolate=True).alignment
    mapped, truth = read_tum(again / "mapped.tum"), read_tum(again / "drive.groundtruth_base.tum")
    true_poses = interpolate_poses(truth.stamps_ns, truth.matrices(), mapped.stamps_ns)
    errors_m = position_errors(map_in_hall.apply(mapped.matrices()), true_poses, planar=True)
    fused = read_tum(again / "fused.tum")
    before = fused.matrices()[fused.stamps_ns <= mapped.stamps_ns[0]]
    way_m = distance_travelled_m(before, planar=True)[-1] if len(before) else 0.0
    return (
        f"found in the map after {way_m:.1f} m; from then on wrong by {np.median(errors_m):.3f} m in the median, "
        f"{errors_m.max():.3f} m at most, at {len(mapped)} keyframes"
    )


def main() -> int:
    """Write the report."""
    directory = Path(sys.argv[1])
    trajectories = json.loads((directory / "evaluation.json").read_text())["trajectories"]
    missing = [label for name, label in NAMES.items() if name not in trajectories]
    if missing:
        print(f"error: {directory}: the nodes published nothing for {', '.join(missing)}", file=sys.stderr)
        return 1
    rows = [row(label, trajectories[name]) for name, label in NAMES.items()]
    print(tabulate(rows, HEADERS, floatfmt=".3f"))
    found = found_in_map(directory) or "NOT FOUND in the map"
    report = directory / "report.md"
    report.write_text(
        "# A simulated drive, live through the nodes\n\n"
        f"{tabulate(rows, HEADERS, tablefmt='github', floatfmt='.3f')}\n\n"
        "Against the simulated truth: wheels and fused after aligning the start (SE(2)), the camera after a Sim(3).\n\n"
        "![Trajectories](trajectory.png)\n\n![Errors over time](error.png)\n\n"
        "# Another drive, in the map of the first one\n\n"
        f"The robot is switched on elsewhere, a third of the lamps is off: {found}.\n\n"
        "![The map: the ceiling from below, and both ways](map.png)\n"
    )
    wheels_m, fused_m = (trajectories[name]["ate_m"]["rmse"] for name in ("wheel", "fused"))
    verdict = "better" if fused_m < wheels_m else "WORSE"
    print(f"fused is {verdict} than the wheels alone: {fused_m:.3f} m against {wheels_m:.3f} m")
    print(f"second drive: {found}; report: {report}")
    return 0 if fused_m < wheels_m and found.startswith("found") else 1


if __name__ == "__main__":
    sys.exit(main())
