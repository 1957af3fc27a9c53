# SPDX-License-Identifier: BSD-3-Clause
"""The map as an image: for people, and for map_server."""

from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from ceiling_dso_ros.lidar.mapping.landmarks import KeyframePoints
from ceiling_dso_ros.lidar.reference import Reference
from ceiling_dso_ros.lidar.rendering_kernels import cast_rays
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints
from ceiling_dso_ros.lidar.scans.sweep_motion import sweep_motions

CELL_M = 0.05
MOST_CELLS = 2**24  # of an image: larger halls have larger cells
MARGIN_M = 1.0
OCCUPIED_SHARE = 0.25  # of the rays that end in a cell, of all that meet it
FEWEST_HITS = 2
OCCUPIED, FREE, UNKNOWN = 0, 254, 205  # as map_server has them
MOST_WALLS = 99.5  # percent of the occupied pixels that a picture shows
PICTURE_PX = 900  # the larger side of a picture, at least
BLUE, GREEN, VERMILION = (178, 114, 0), (115, 158, 0), (0, 94, 213)  # BGR


@dataclass(frozen=True)
class MapImage:
    """An occupancy map.

    Attributes:
        pixels: (rows, columns) uint8 OCCUPIED, FREE or UNKNOWN, row 0 at the largest y.
        origin: x, y of the lower left corner, metres.
        cell_m: size of a pixel.
    """

    pixels: np.ndarray
    origin: Tuple[float, float]
    cell_m: float

    def pgm(self) -> bytes:
        """As a PGM file."""
        rows, columns = self.pixels.shape
        return f"P5\n{columns} {rows}\n255\n".encode() + self.pixels.tobytes()

    def yaml(self, image_name: str) -> bytes:
        """As map_server reads it."""
        x, y = self.origin
        return (
            f"image: {image_name}\nresolution: {self.cell_m:g}\norigin: [{x:.6f}, {y:.6f}, 0.0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
        ).encode()

    def png(self) -> bytes:
        """As a PNG file of the same pixels."""
        return _png(self.pixels)

    def columns_rows(self, points: np.ndarray) -> np.ndarray:
        """Pixels (n, 2) of points (n, 2) in the map, not rounded."""
        rows = self.pixels.shape[0]
        x, y = (points - self.origin).T / self.cell_m
        return np.column_stack([x, rows - y])


def draw_map(reference: Reference) -> MapImage:
    """The map of all keyframes."""
    scans, solution = reference.scans, reference.solution
    points = ScanPoints(scans)
    motions = sweep_motions(scans, points, reference.wheels, reference.path.poses, solution.track.twists)
    keyframes = KeyframePoints.of(
        [points.of(scan, motions[scan]) for scan in solution.keyframes.tolist()], points.laser
    )
    placed, eyes = keyframes.placed(solution.joint.poses), keyframes.eyes(solution.joint.poses)
    met = np.concatenate([placed, eyes, reference.path.poses[:, :2]])
    low, high = met.min(axis=0) - MARGIN_M, met.max(axis=0) + MARGIN_M
    cell_m = CELL_M
    while np.prod((high - low) / cell_m) > MOST_CELLS:
        cell_m *= 2.0
    origin = cell_m * np.floor(low / cell_m)
    columns, rows = (int(each) for each in np.ceil((high - origin) / cell_m))
    hits, passes = np.zeros((rows, columns), np.int32), np.zeros((rows, columns), np.int32)
    cast_rays(placed, keyframes.first, eyes, origin, cell_m, hits, passes)
    met_by = hits + passes
    is_occupied = (hits >= FEWEST_HITS) & (hits > OCCUPIED_SHARE * met_by)
    pixels = np.where(is_occupied, OCCUPIED, np.where(met_by > 0, FREE, UNKNOWN)).astype(np.uint8)
    return MapImage(np.ascontiguousarray(pixels[::-1]), (float(origin[0]), float(origin[1])), cell_m)


def draw_trajectory(reference: Reference, map_image: MapImage) -> bytes:
    """A PNG file of the map with the trajectory: blue, and vermilion where it is least sure; the start is green."""
    map_image = _cropped(map_image, map_image.columns_rows(reference.path.poses[:, :2]))
    factor = max(1, round(PICTURE_PX / max(map_image.pixels.shape)))
    large = cv2.resize(map_image.pixels, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    picture = cv2.cvtColor(np.where(large == UNKNOWN, 235, large).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    pixels = np.round(factor * 16 * map_image.columns_rows(reference.path.poses[:, :2])).astype(np.int32)
    sigmas = reference.position_sigmas_m
    doubtful = sigmas > 3.0 * np.median(sigmas)
    thickness = max(1, factor)
    for number in range(len(pixels) - 1):
        colour = VERMILION if doubtful[number] else BLUE
        cv2.line(
            picture,
            tuple(pixels[number].tolist()),
            tuple(pixels[number + 1].tolist()),
            colour,
            thickness,
            cv2.LINE_AA,
            4,
        )
    start = tuple((pixels[0] // 16).tolist())
    cv2.circle(picture, start, 3 * factor, GREEN, -1, cv2.LINE_AA)
    _draw_scale(picture, factor / map_image.cell_m)
    return _png(picture)


def _cropped(map_image: MapImage, path: np.ndarray) -> MapImage:
    """The part with the path, (N, 2) columns and rows, and nearly all of the walls: few rays go far through windows."""
    rows, columns = np.nonzero(map_image.pixels == OCCUPIED)
    margin = MARGIN_M / map_image.cell_m
    x, y = path.T
    if len(rows):
        x = np.append(x, np.percentile(columns, (100.0 - MOST_WALLS, MOST_WALLS)))
        y = np.append(y, np.percentile(rows, (100.0 - MOST_WALLS, MOST_WALLS)))
    height, width = map_image.pixels.shape
    left, right = max(0, int(x.min() - margin)), min(width, int(x.max() + margin) + 1)
    top, bottom = max(0, int(y.min() - margin)), min(height, int(y.max() + margin) + 1)
    corner = (map_image.origin[0] + left * map_image.cell_m, map_image.origin[1] + (height - bottom) * map_image.cell_m)
    return MapImage(np.ascontiguousarray(map_image.pixels[top:bottom, left:right]), corner, map_image.cell_m)


def _draw_scale(picture: np.ndarray, pixels_per_m: float) -> None:
    """A bar of 1, 5 or 20 m in the lower left corner."""
    length_m = next((m for m in (20, 5, 1) if m * pixels_per_m < 0.4 * picture.shape[1]), 1)
    row, end = picture.shape[0] - 12, 12 + round(length_m * pixels_per_m)
    cv2.line(picture, (12, row), (end, row), (0, 0, 0), 3)
    cv2.putText(picture, f"{length_m} m", (12, row - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)


def _png(pixels: np.ndarray) -> bytes:
    _, data = cv2.imencode(".png", pixels)
    return bytes(data)
