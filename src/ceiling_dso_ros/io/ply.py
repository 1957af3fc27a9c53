# SPDX-License-Identifier: BSD-3-Clause
"""Point clouds in the PLY format, binary little endian."""

from dataclasses import dataclass
from pathlib import Path
from typing import Union

import numpy as np

from ceiling_dso_ros.io.replacing import replace_file

GREY_CHANNELS = ("red", "green", "blue")
PROPERTIES = {
    **dict.fromkeys("xyz", "<f4"),
    **dict.fromkeys(GREY_CHANNELS, "u1"),
    "segment": "<i4",
    "keyframe_id": "<i4",
}
PLY_TYPES = {"<f4": "float", "u1": "uchar", "<i4": "int"}  # by numpy's name
VERTEX = np.dtype(list(PROPERTIES.items()))
COMMENT = "VO world; every segment has its own unit of length"


@dataclass(frozen=True)
class PointCloud:
    """Points of the map.

    Attributes:
        positions: (N, 3) float64 in the VO world, VO units.
        grey: (N,) float32 grey levels; the file has them rounded and limited to 0..255.
        segments: (N,) int64 segment of each point.
        keyframe_ids: (N,) int64 keyframe that hosts it.
    """

    positions: np.ndarray
    grey: np.ndarray
    segments: np.ndarray
    keyframe_ids: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)


def write_ply(path: Union[str, Path], cloud: PointCloud) -> None:
    """Write a PLY file of vertices with PROPERTIES; an older one is replaced when this is complete.

    Raises:
        OutputError: the file cannot be written.
    """
    vertices = np.empty(len(cloud), VERTEX)
    for axis, values in zip("xyz", cloud.positions.T):
        vertices[axis] = values
    for channel in GREY_CHANNELS:
        vertices[channel] = np.rint(cloud.grey).clip(0, 255)
    vertices["segment"], vertices["keyframe_id"] = cloud.segments, cloud.keyframe_ids
    replace_file(path, _header(len(cloud)).encode() + vertices.tobytes(), "the point cloud")


def _header(count: int) -> str:
    properties = [f"property {PLY_TYPES[kind]} {name}" for name, kind in PROPERTIES.items()]
    lines = ["ply", "format binary_little_endian 1.0", f"comment {COMMENT}", f"element vertex {count}", *properties]
    return "\n".join([*lines, "end_header", ""])
