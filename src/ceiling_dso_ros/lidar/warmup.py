# SPDX-License-Identifier: BSD-3-Clause
"""Compile and cache every kernel of the reference trajectory: `python3 -m ceiling_dso_ros.lidar.warmup`."""

import sys
from pathlib import Path
from typing import Callable, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import cache_folders
from ceiling_dso_ros.dso.compute.kernel_cache import compile_if_missing, complete_marker, fill_cache
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.reference import Reference, estimate_reference
from ceiling_dso_ros.lidar.rendering import MapImage, draw_map
from ceiling_dso_ros.lidar.scans.scan_kernels import undistorted_points

NAME = "lidar"
SCANS, RAYS, STEP_M = 40, 181, 0.1


def sample_scans() -> LaserScans:
    """A robot that drives along a room of 8 x 5 m, and then is somewhere else."""
    angles = np.radians(np.linspace(-135.0, 135.0, RAYS))
    c, s = np.cos(angles), np.sin(angles)
    ranges = np.empty((SCANS, RAYS), np.float32)
    for scan in range(SCANS):
        x, y = -2.0 + STEP_M * scan, 0.3 if scan < SCANS - 5 else -1.0
        with np.errstate(divide="ignore"):
            along = np.where(c > 0, (4.0 - x) / c, (-4.0 - x) / c)
            ranges[scan] = np.minimum(along, np.where(s > 0, (2.5 - y) / s, (-2.5 - y) / s))
    geometry = np.tile((angles[0], angles[1] - angles[0], 1e-4), (SCANS, 1))
    return LaserScans(100_000_000 * np.arange(SCANS, dtype=np.int64), ranges, geometry, np.eye(4))


def warm_up() -> Tuple[Reference, MapImage]:
    """Make a reference from a few scans, and its map."""
    reference = estimate_reference(sample_scans(), None)
    return reference, draw_map(reference)


def load_kernels(tell: Callable[[str], None]) -> None:
    """Have every kernel ready.

    Args:
        tell: see `compile_if_missing`.
    """
    compile_if_missing(_marker(), __name__, tell)


def _marker() -> Optional[Path]:
    return complete_marker(undistorted_points, [Path(__file__).parent], NAME)


def main() -> int:
    """Entry point."""
    folders = {each for each in cache_folders() if NAME in each.parts}
    return fill_cache(_marker(), folders, lambda: bool(warm_up()))


if __name__ == "__main__":
    sys.exit(main())
