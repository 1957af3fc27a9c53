#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Compares the poses published by the nodes with the wheels alone: scripts/demo_report.py DIR, after `evaluate DIR`.

Prints a table and writes DIR/report.md with the figures; exits with 1 when the fused odometry is worse.
"""

import json
import sys
from pathlib import Path
from typing import Dict, List

from tabulate import tabulate

HEADERS = ["trajectory", "poses", "ATE rmse [m]", "largest [m]", "of the way [%]", "rotation rmse [deg]"]
NAMES = {"wheel": "wheels alone", "camera": "camera alone, after scaling", "fused": "fused"}


def row(label: str, numbers: Dict) -> List:
    """One line of the table."""
    ate_m = numbers["ate_m"]
    percent = 100.0 * ate_m["rmse"] / numbers["path_m"]
    return [label, numbers["poses"], ate_m["rmse"], ate_m["max"], percent, numbers["rotation_deg"]["rmse"]]


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
    report = directory / "report.md"
    report.write_text(
        "# A simulated drive, live through the nodes\n\n"
        f"{tabulate(rows, HEADERS, tablefmt='github', floatfmt='.3f')}\n\n"
        "Against the simulated truth: wheels and fused after aligning the start (SE(2)), the camera after a Sim(3).\n\n"
        "![Trajectories](trajectory.png)\n\n![Errors over time](error.png)\n"
    )
    wheels_m, fused_m = (trajectories[name]["ate_m"]["rmse"] for name in ("wheel", "fused"))
    verdict = "better" if fused_m < wheels_m else "WORSE"
    print(f"fused is {verdict} than the wheels alone: {fused_m:.3f} m against {wheels_m:.3f} m; report: {report}")
    return 0 if fused_m < wheels_m else 1


if __name__ == "__main__":
    sys.exit(main())
