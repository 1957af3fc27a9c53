# SPDX-License-Identifier: BSD-3-Clause
"""The picture of a map: the ceiling as a mosaic, the ways under it, and the loops."""

from pathlib import Path
from typing import Mapping, Optional, Tuple

import cv2
import numpy as np
from matplotlib.figure import Figure

from ceiling_dso_ros.evaluation.figures import COLOURS, save_figure
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.records import T_upright_camera
from ceiling_dso_ros.slam.site_map import MapKeyframe, SiteMap

PIXEL_M = 0.04
MOST_PIXELS = 4000  # of a side
MARGIN_M = 4.0
LOOP_COLOUR = "#D55E00"
WAY_COLOURS = tuple(colour for colour in COLOURS if colour != LOOP_COLOUR)


def mosaic(site: SiteMap) -> Tuple[np.ndarray, Tuple[float, float, float, float]]:
    """The ceiling, each image laid on the horizontal plane in the middle of its points.

    Returns:
        (H, W) float32 grey levels, nan where nothing was seen, row 0 at the smallest y; and the smallest and largest x,
        the smallest and largest y, metres.
    """
    low, high = site.poses[:, :2].min(axis=0) - MARGIN_M, site.poses[:, :2].max(axis=0) + MARGIN_M
    pixel_m = max(PIXEL_M, float((high - low).max()) / MOST_PIXELS)
    width, height = (int(side) + 1 for side in (high - low) / pixel_m)
    total, weight = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    to_metres = np.array([[pixel_m, 0.0, low[0]], [0.0, pixel_m, low[1]], [0.0, 0.0, 1.0]])
    own = site.camera.camera
    fade = np.outer(np.hanning(own.height + 2)[1:-1], np.hanning(own.width + 2)[1:-1]).astype(np.float32)
    for keyframe in site.keyframes:
        warp = _map_to_image(site, keyframe) @ to_metres
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        image = keyframe.record.image.astype(np.float32)
        total += cv2.warpPerspective(image * fade, warp, (width, height), flags=flags)
        weight += cv2.warpPerspective(fade, warp, (width, height), flags=flags)
    seen = np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), np.nan)
    return seen, (float(low[0]), float(low[0] + width * pixel_m), float(low[1]), float(low[1] + height * pixel_m))


def write_map_figure(path: Path, site: SiteMap, ways: Optional[Mapping[str, np.ndarray]] = None) -> None:
    """Write the picture as PNG or SVG, as the ending says.

    Args:
        path: of the picture.
        site: the map.
        ways: name -> (N, 3) positions in map, metres, of robots that were localised in it.

    Raises:
        OutputError: the file cannot be written.
    """
    save_figure(lambda: _figure(site, ways or {}), path)


def _figure(site: SiteMap, ways: Mapping[str, np.ndarray]) -> Figure:
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    seen, extent = mosaic(site)
    axes.imshow(
        seen, extent=(*extent[:2], extent[3], extent[2]), cmap="gray", vmin=0, vmax=255, interpolation="antialiased"
    )
    poses = site.poses
    for edge in site.edges:
        if edge.is_loop:
            axes.plot(*poses[[edge.start, edge.end], :2].T, color=LOOP_COLOUR, linewidth=1.0, zorder=3)
    sessions = np.array([keyframe.session for keyframe in site.keyframes])
    for session in np.unique(sessions).tolist():
        own = poses[sessions == session]
        colour = WAY_COLOURS[session % len(WAY_COLOURS)]
        axes.plot(own[:, 0], own[:, 1], ".", color=colour, markersize=3.0, label=f"drive {session + 1}", zorder=4)
    for index, (name, positions_m) in enumerate(ways.items()):
        colour = WAY_COLOURS[(site.sessions + index) % len(WAY_COLOURS)]
        axes.plot(positions_m[:, 0], positions_m[:, 1], color=colour, linewidth=1.5, label=name, zorder=5)
        axes.plot(*positions_m[0, :2], "o", color=colour, markeredgecolor="white", markersize=6.0, zorder=6)
    axes.plot([], [], color=LOOP_COLOUR, label="loops")
    axes.set(xlabel="x [m]", ylabel="y [m]", title="the ceiling from below (y points down), and the ways under it")
    axes.set_aspect("equal")
    axes.grid(False)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _map_to_image(site: SiteMap, keyframe: MapKeyframe) -> np.ndarray:
    """(3, 3) homography from (x, y, 1) in map, in the plane of the keyframe's ceiling, to pixels of its image."""
    T_camera_map = np.linalg.inv(
        planar.lift(keyframe.pose) @ T_upright_camera(keyframe.record.tilt, site.camera.T_base_camera)
    )
    on_plane = np.column_stack(
        [T_camera_map[:3, 0], T_camera_map[:3, 1], T_camera_map[:3, 2] * keyframe.record.height_m + T_camera_map[:3, 3]]
    )
    return site.camera.camera.matrix @ on_plane
