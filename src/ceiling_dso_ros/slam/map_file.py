# SPDX-License-Identifier: BSD-3-Clause
"""Files of maps: a zip archive of numpy arrays without pickled objects. The same map gives the same bytes."""

import io
import json
import math
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Dict, List, Union

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.io.errors import InputError, reason_of
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.slam.records import Corners, KeyframeRecord, RecordCamera
from ceiling_dso_ros.slam.site_map import Edge, MapKeyframe, SiteMap

VERSION = 2
KIND = "ceiling_dso_ros map"
EARLIEST = (1980, 1, 1, 0, 0, 0)  # of a zip archive
LARGEST_BYTES = 2**31  # of all arrays together
HEAD = "head"
# Name of each array -> its type, and its shape: a letter is the number of keyframes (N), points (P), corners (K), edges
# (E), or rows (H) and columns (W) of an image.
ARRAYS = {
    "stamp_ns": ("<i8", "N"),
    "session": ("<i4", "N"),
    "pose": ("<f8", "N3"),
    "odometry_pose": ("<f8", "N3"),
    "step_covariance": ("<f8", "N33"),
    "tilt": ("<f8", "N2"),
    "tilt_sigma": ("<f8", "N2"),
    "image": ("|u1", "NHW"),
    "point_count": ("<i4", "N"),
    "point": ("<f4", "P3"),
    "corner_count": ("<i4", "N"),
    "corner": ("<f4", "K3"),
    "descriptor": ("<u8", "K4"),
    "edge": ("<i4", "E2"),
    "edge_motion": ("<f8", "E3"),
    "edge_covariance": ("<f8", "E33"),
    "edge_is_loop": ("|b1", "E"),
}

DAMAGES = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError),  # of the archive, also of deep nesting
    *(tokenize.TokenError, SyntaxError),  # of numpy's headers
    *(ValueError, KeyError, TypeError, ArithmeticError),  # of what is in it
)


def write_map(path: Union[str, Path], site: SiteMap) -> None:
    """Write a map; an older file is replaced when this one is complete.

    Raises:
        OutputError: the file cannot be written.
    """
    replace_file(path, map_bytes(site), "the map")


def map_bytes(site: SiteMap) -> bytes:
    """The content of a file."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        _add(archive, HEAD, json.dumps(_head(site), sort_keys=True).encode())
        for name, values in _arrays(site).items():
            content = io.BytesIO()
            np.save(content, np.ascontiguousarray(values), allow_pickle=False)
            _add(archive, f"{name}.npy", content.getvalue())
    return buffer.getvalue()


def read_map(path: Union[str, Path]) -> SiteMap:
    """Read a map.

    Raises:
        InputError: the file cannot be read, is no map, is of another version, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(archive)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {reason_of(error)}") from error
    except _OtherVersionError as error:
        raise InputError(f"{path}: {error}") from error
    except DAMAGES as error:
        raise InputError(f"{path}: is no map, or is damaged; build it again with `map build` ({error})") from error


def require_camera(path: Union[str, Path], site: SiteMap, camera: RecordCamera) -> None:
    """Check that a camera can be used in a map.

    Raises:
        InputError: it is another one, or it is mounted differently.
    """
    if not site.camera.same_as(camera):
        raise InputError(
            f"{path}: the map was built with another camera or mount: its images of {_described(site.camera)}, "
            f"these of {_described(camera)}; build a map with this camera"
        )


class _OtherVersionError(ValueError):
    """The file was written by another version of the package."""


def _described(camera: RecordCamera) -> str:
    own, (x, y, z) = camera.camera, camera.T_base_camera[:3, 3]
    return f"{own.width}x{own.height}, fx {own.fx:.2f} px, at ({x:.3f}, {y:.3f}, {z:.3f}) m"


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    entry = zipfile.ZipInfo(name, EARLIEST)
    entry.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(entry, content)


def _head(site: SiteMap) -> Dict[str, object]:
    own = site.camera.camera
    return {
        "kind": KIND,
        "version": VERSION,
        "camera": [own.fx, own.fy, own.cx, own.cy, own.width, own.height],
        "T_base_camera": site.camera.T_base_camera.tolist(),
    }


def _arrays(site: SiteMap) -> Dict[str, np.ndarray]:
    records = [keyframe.record for keyframe in site.keyframes]
    size = site.camera.camera.height, site.camera.camera.width

    def joined(parts: List[np.ndarray], width: int) -> np.ndarray:
        return np.concatenate([np.zeros((0, width)), *parts]) if not parts else np.concatenate(parts)

    values = {
        "stamp_ns": [record.stamp_ns for record in records],
        "session": [keyframe.session for keyframe in site.keyframes],
        "pose": np.reshape([keyframe.pose for keyframe in site.keyframes], (-1, 3)),
        "odometry_pose": np.reshape([record.pose for record in records], (-1, 3)),
        "step_covariance": np.reshape([record.step_covariance for record in records], (-1, 3, 3)),
        "tilt": np.reshape([record.tilt.angles for record in records], (-1, 2)),
        "tilt_sigma": np.reshape([record.tilt.sigmas for record in records], (-1, 2)),
        "image": np.reshape([record.image for record in records], (-1, *size)),
        "point_count": [len(record.points) for record in records],
        "point": joined([record.points for record in records], 3),
        "corner_count": [len(record.corners.descriptor) for record in records],
        "corner": joined([record.corners.position for record in records], 3),
        "descriptor": joined([record.corners.descriptor for record in records], 4),
        "edge": np.reshape([(edge.start, edge.end) for edge in site.edges], (-1, 2)),
        "edge_motion": np.reshape([edge.motion for edge in site.edges], (-1, 3)),
        "edge_covariance": np.reshape([edge.covariance for edge in site.edges], (-1, 3, 3)),
        "edge_is_loop": [edge.is_loop for edge in site.edges],
    }
    return {name: np.asarray(values[name], ARRAYS[name][0]) for name in ARRAYS}


def _read(archive: zipfile.ZipFile) -> SiteMap:
    if sum(entry.file_size for entry in archive.infolist()) > LARGEST_BYTES:
        raise ValueError("it is too large")
    head = json.loads(archive.read(HEAD))
    if not isinstance(head, dict) or head.get("kind") != KIND:
        raise ValueError("another kind of file")
    if head["version"] > VERSION:
        raise _OtherVersionError(
            f"is a map of version {head['version']}, this package reads up to {VERSION}: update the package"
        )
    if head["version"] < VERSION:
        raise _OtherVersionError(
            f"is a map of version {head['version']}, whose views are not upright; build it again with `map build`"
        )
    arrays = {name: _array(archive.read(f"{name}.npy")) for name in ARRAYS}
    fx, fy, cx, cy, width, height = head["camera"]
    camera = RecordCamera(
        PinholeCamera(float(fx), float(fy), float(cx), float(cy), int(width), int(height)),
        np.array(head["T_base_camera"], np.float64).reshape(4, 4),
    )
    if not (np.isfinite(camera.T_base_camera).all() and np.isfinite(camera.camera.parameters).all()):
        raise ValueError("the camera has numbers that are not finite")
    _check(arrays, {"H": camera.camera.height, "W": camera.camera.width})
    return SiteMap(camera, tuple(_keyframes(arrays)), tuple(_edges(arrays)))


def _array(content: bytes) -> np.ndarray:
    """An array, whose declared size is checked before memory is taken for it."""
    file = io.BytesIO(content)
    if np.lib.format.read_magic(file) != (1, 0):  # type: ignore[no-untyped-call]  # numpy's have no types
        raise ValueError("arrays of another version")
    shape, _, kind = np.lib.format.read_array_header_1_0(file)  # type: ignore[no-untyped-call]  # likewise
    if math.prod(shape) * kind.itemsize != len(content) - file.tell():
        raise ValueError("an array has another size than it declares")
    file.seek(0)
    return np.load(file, allow_pickle=False)


def _check(arrays: Dict[str, np.ndarray], sizes: Dict[str, int]) -> None:
    """Raise ValueError unless all arrays fit together and are finite."""
    for name, (kind, shape) in ARRAYS.items():
        values = arrays[name]
        if values.dtype != np.dtype(kind) or values.ndim != len(shape):
            raise ValueError(f"{name} has another type")
        for letter, side in zip(shape, values.shape):
            if side != (int(letter) if letter.isdigit() else sizes.setdefault(letter, side)):
                raise ValueError(f"{name} has another size")
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise ValueError(f"{name} has numbers that are not finite")
    for counts, letter in (("point_count", "P"), ("corner_count", "K")):
        if (arrays[counts] < 0).any() or arrays[counts].sum() != sizes[letter]:
            raise ValueError(f"{counts} does not fit")
    if (arrays["edge"] < 0).any() or (arrays["edge"] >= sizes["N"]).any():
        raise ValueError("an edge leads to a keyframe that is not there")


def _keyframes(arrays: Dict[str, np.ndarray]) -> List[MapKeyframe]:
    points = np.split(arrays["point"], np.cumsum(arrays["point_count"])[:-1])
    corners, descriptors = (
        np.split(arrays[name], np.cumsum(arrays["corner_count"])[:-1]) for name in ("corner", "descriptor")
    )
    return [
        MapKeyframe(
            KeyframeRecord(
                int(arrays["stamp_ns"][i]),
                arrays["odometry_pose"][i],
                arrays["step_covariance"][i],
                arrays["image"][i],
                points[i],
                Corners(corners[i], descriptors[i]),
                Tilt(arrays["tilt"][i], arrays["tilt_sigma"][i]),
            ),
            arrays["pose"][i],
            int(arrays["session"][i]),
        )
        for i in range(len(arrays["stamp_ns"]))
    ]


def _edges(arrays: Dict[str, np.ndarray]) -> List[Edge]:
    return [
        Edge(int(start), int(end), motion, covariance, bool(is_loop))
        for (start, end), motion, covariance, is_loop in zip(
            arrays["edge"], arrays["edge_motion"], arrays["edge_covariance"], arrays["edge_is_loop"]
        )
    ]
