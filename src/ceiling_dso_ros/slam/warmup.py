# SPDX-License-Identifier: BSD-3-Clause
"""Compile and cache the kernels of the map before the first keyframe: `python3 -m ceiling_dso_ros.slam.warmup`."""

import sys
from pathlib import Path
from typing import Callable, Optional

import numpy as np

from ceiling_dso_ros.dso.compute.kernel_cache import compile_if_missing, complete_marker, fill_cache
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.dso.warmup import textured_plane
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.slam.localiser import Localisation, Localiser
from ceiling_dso_ros.slam.matching_kernels import vote
from ceiling_dso_ros.slam.records import KeyframeRecord, KeyframeView, RecordCamera, View
from ceiling_dso_ros.slam.site_map import MapKeyframe, SiteMap
from ceiling_dso_ros.slam.verification import Verified, Verifier

CAMERA = PinholeCamera(200.0, 200.0, 211.5, 119.5, 424, 240)
STEP = 0.1  # depths, which are metres here
KEYFRAMES = 2
UPRIGHT = Tilt(np.zeros(2), np.full(2, 1e-3))


def warm_up() -> bool:
    """Compare views of a plane as a map does; returns whether all went well."""
    records = [_record(number) for number in range(KEYFRAMES)]
    camera = RecordCamera.of(CAMERA, np.eye(4))
    site = SiteMap(camera, tuple(MapKeyframe(record, record.pose, 0) for record in records), ())
    localiser = Localiser(site)
    for record in records:
        localiser.add(record)
    found = Verifier(camera).verify(records[0], records[1])
    return isinstance(found, Verified) and localiser.state is not Localisation.LOCALISED


def _record(number: int) -> KeyframeRecord:
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(6, 420, 12.0), np.arange(6, 236, 12.0)))
    rays = viewing_rays(CAMERA.parameters, u, v)
    handed = KeyframeView.of(number, number, textured_plane(CAMERA, STEP * number), CAMERA, rays)
    view = View.of(handed.image, handed.camera, handed.points.astype(np.float64))
    return view.record(number, 1.0, np.eye(4), np.array([STEP * number, 0.0, 0.0]), 1e-6 * np.eye(3), UPRIGHT)


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
    return complete_marker(vote, [own, own.parent / "dso"], "map_kernels")


def main() -> int:
    """Entry point."""
    marker = _marker()
    return fill_cache(marker, set() if marker is None else {marker.parent}, warm_up)


if __name__ == "__main__":
    sys.exit(main())
