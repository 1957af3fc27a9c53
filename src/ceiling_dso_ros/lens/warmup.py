# SPDX-License-Identifier: BSD-3-Clause
"""Compile and cache the kernels of the lens's calibration: `python3 -m ceiling_dso_ros.lens.warmup`."""

import sys
from pathlib import Path
from typing import Callable, Optional

import numpy as np

from ceiling_dso_ros.dso.compute.kernel_cache import compile_if_missing, complete_marker, fill_cache
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.dso.warmup import textured_plane
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.elimination_kernels import (
    CAMERA,
    KEYFRAME,
    POINT,
    Equations,
    add_sightings,
    point_steps,
    sighting_scores,
)
from ceiling_dso_ros.lens.patch_kernels import align_patches
from ceiling_dso_ros.lens.tracks import SeenKeyframe, follow

CAMERA_SEEN = PinholeCamera(100.0, 100.0, 79.5, 59.5, 160, 120)
LENS = LensCamera("Pinhole", 100.0, 100.0, 79.5, 59.5, (), 160, 120)
STEP = 0.02  # depths


def warm_up() -> bool:
    """Follow the corners of a plane and set up the equations; returns whether any was found."""
    tracks = follow((_keyframe(number) for number in range(2)), LENS)
    sightings = len(tracks.target)
    points = len(tracks.host)
    equations = Equations(
        tracks.first,
        tracks.host,
        tracks.target,
        CAMERA,
        np.ones((sightings, 2, CAMERA)),
        np.ones((sightings, 2, KEYFRAME)),
        np.ones((sightings, 2, KEYFRAME)),
        np.ones((sightings, 2, POINT)),
        np.ones((sightings, 2)),
        np.tile(np.eye(POINT), (points, 1, 1)),
        np.zeros((points, POINT)),
    )
    size = CAMERA + 2 * KEYFRAME
    groups, none = np.zeros(sightings, np.int64), np.zeros(points, np.int64)
    add_sightings(equations, cluster=none, H=np.zeros((size, size)), scores=np.zeros((1, size)))
    sighting_scores(equations, group=groups, host_group=none, scores=np.zeros((1, size)))
    steps = point_steps(equations, step=np.ones(size))
    return sightings > 0 and bool(np.isfinite(steps).all())


def _keyframe(number: int) -> SeenKeyframe:
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(6, 150, 12.0), np.arange(6, 110, 12.0)))
    image = np.clip(textured_plane(CAMERA_SEEN, STEP * number), 0.0, 255.0).astype(np.uint8)
    T = np.eye(4)
    T[0, 3] = STEP * number
    return SeenKeyframe(number, 0, T, image, CAMERA_SEEN, viewing_rays(CAMERA_SEEN.parameters, u, v))


def load_kernels(tell: Callable[[str], None]) -> None:
    """Have every kernel ready.

    Args:
        tell: see `compile_if_missing`.
    """
    compile_if_missing(_marker(), __name__, tell)
    warm_up()


def _marker() -> Optional[Path]:
    """The file that says that the cache is complete; None where nothing can be cached."""
    own = Path(__file__).parent
    return complete_marker(align_patches, [own, own.parent / "dso"], "lens_kernels")


def main() -> int:
    """Entry point."""
    marker = _marker()
    return fill_cache(marker, set() if marker is None else {marker.parent}, warm_up)


if __name__ == "__main__":
    sys.exit(main())
