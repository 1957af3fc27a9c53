# SPDX-License-Identifier: BSD-3-Clause
"""Maps of simulated halls against the truth: wrong loops, recall of revisits, robots that are switched on anywhere.

Halls are drawn at random. The map is built on one drive. Robots are switched on along another one, at another time: a
third of the lamps is off. docs/map.md defines what is counted.
"""

import argparse
import sys
from pathlib import Path
from typing import Dict, List

import numpy as np
from support.table import Row, report

from ceiling_dso_ros.experiments.mapped_hall import Counts, MappedHall
from ceiling_dso_ros.experiments.rendered_keyframes import RenderedKeyframes
from ceiling_dso_ros.simulation.drawn import draw_camera, draw_config
from ceiling_dso_ros.slam.map_file import map_bytes

WIDTH, HEIGHT = 424, 240
SEQUENCE = "weave"
MOST_M = 8.0  # that a robot drives until it is given up
KINDS = {False: "any roof", True: "strictly periodic roof"}


def main() -> int:
    """Print one table; 1 when a limit does not hold."""
    parser = argparse.ArgumentParser(prog="scripts/bench map", description=__doc__)
    parser.add_argument("--halls", metavar="N", type=int, default=3, help="default %(default)s; 20 for the full size")
    parser.add_argument("--first-seed", metavar="N", type=int, default=0, help="of the halls (default %(default)s)")
    parser.add_argument("--starts", metavar="N", type=int, default=3, help="in each hall (default %(default)s)")
    parser.add_argument("--step", metavar="M", type=float, default=0.5, help="between keyframes (default %(default)s)")
    parser.add_argument("--duration", metavar="S", type=float, default=60.0, help="of the drive, (default %(default)s)")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/bench/map"), help="for rendered images")
    options = parser.parse_args()
    counts: Dict[bool, Counts] = {}
    sizes_mb: List[float] = []
    errors_mm: Dict[bool, List[float]] = {}
    for seed in range(options.first_seed, options.first_seed + options.halls):
        first, again = (_keyframes(seed, session, options) for session in (0, 1))
        hall = MappedHall(first)
        found = hall.counts
        for start in np.linspace(0, 0.8 * len(again.stamps_ns), options.starts).astype(int).tolist():
            found = found + hall.start_from(again, start, MOST_M)
        counts[first.is_periodic] = counts.get(first.is_periodic, Counts()) + found
        errors_mm.setdefault(first.is_periodic, []).append(1e3 * max(hall.errors_m))
        sizes_mb.append(1e-6 * len(map_bytes(hall.site)))
        print(f"seed {seed}, {KINDS[first.is_periodic]}: {found}", file=sys.stderr)
    rows = [row for kind in sorted(counts) for row in _rows(kind, counts[kind], errors_mm[kind])]
    rows.append(Row("all", "size of a map, MB", sizes_mb, 15.0))
    print(report(rows))
    return 0 if all(row.holds for row in rows) else 1


def _keyframes(seed: int, session: int, options: argparse.Namespace) -> RenderedKeyframes:
    camera = draw_camera(seed, width=WIDTH, height=HEIGHT)
    config = draw_config(SEQUENCE, seed, session=session, camera=camera, duration_s=options.duration)
    return RenderedKeyframes(config, options.step, options.out)


def _rows(is_periodic: bool, counts: Counts, errors_mm: List[float]) -> List[Row]:
    kind = KINDS[is_periodic]
    rows = [
        Row(kind, "comparisons; loops", [counts.comparisons, counts.loops]),
        Row(kind, "wrong loops", [counts.wrong_loops], 0.0),
        Row(kind, "keyframes with a wrong place, of those with one", [counts.wrong_places], 0.0),
        Row(kind, "keyframes with a place", [counts.placed]),
        Row(kind, "revisits below 1 m, 1 to 2 m", [counts.near, counts.far]),
    ]
    lowest = (-np.inf, -np.inf, -np.inf) if is_periodic else (0.95, 0.7, 0.95)
    shares = ((counts.near_seen, counts.near), (counts.far_seen, counts.far), (len(counts.found_m), counts.starts))
    names = ("recall below 1 m", "recall at 1 to 2 m", "starts in which the robot was found")
    for name, (part, whole), low in zip(names, shares, lowest):
        if whole:
            rows.append(Row(kind, name, [part / whole], low=low))
    if counts.found_m:
        rows.append(
            Row(kind, "way until found, median and largest, m", [float(np.median(counts.found_m)), max(counts.found_m)])
        )
    rows.append(Row(kind, "largest error of the keyframes in each map, mm", errors_mm))
    return rows


if __name__ == "__main__":
    sys.exit(main())
