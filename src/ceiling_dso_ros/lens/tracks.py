# SPDX-License-Identifier: BSD-3-Clause
"""Corners of keyframes, followed into the keyframes after them: where each was seen, with its information.

The odometry's poses and points only say where to look. What is measured are pixels of the raw image, so that nothing of
the lens with which the images were undistorted remains in them.
"""

from collections import deque
from dataclasses import dataclass
from typing import Deque, Iterable, List, NamedTuple, Sequence, Tuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import Intrinsics, normalized, viewing_rays
from ceiling_dso_ros.dso.geometry.projection import pixels as pixels_at
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.parameters import pixels_of
from ceiling_dso_ros.lens.patch_kernels import RADIUS, align_patches

CORNERS = 60  # of a keyframe
QUALITY = 0.01  # of a corner, relative to the best one of the image
SPREAD = 32  # corners are at least the image's width over this apart
BORDER_PX = RADIUS + 4
TARGETS = 12  # keyframes after its own in which a corner is looked for
DEPTH_REACH = 0.08  # of the image's width, between a corner and the points that give its first depth
NEIGHBOURS = 3
STEP_PX = 0.5  # of numeric derivatives of the undistortion


@dataclass(frozen=True)
class SeenKeyframe:
    """What is kept of a keyframe.

    Attributes:
        stamp_ns: of its image, nanoseconds.
        segment: of the visual odometry.
        T_world_camera: (4, 4) float64 in that segment's world and unit.
        image: (height, width) uint8, undistorted.
        camera: of that image.
        points: (N, 3) of the map in the camera's frame, in view, VO units.
    """

    stamp_ns: int
    segment: int
    T_world_camera: np.ndarray
    image: np.ndarray
    camera: PinholeCamera
    points: np.ndarray


@dataclass(frozen=True)
class Tracks:
    """Points and where they were seen. Pixels are those of the raw image.

    Attributes:
        host: (P,) int64 keyframe in which each point was found; points are sorted by it.
        host_ray: (P, 2) float64 ray there by the lens that the images were undistorted with: a first guess.
        host_pixel: (P, 2) float64.
        host_information: (P, 2, 2) float64, 1 / pixels squared.
        idepth: (P,) float64 inverse depth in the host, 1 / VO unit: a first guess.
        first: (P + 1,) int64: the sightings of point p are first[p] to first[p + 1] - 1.
        target: (M,) int64 keyframe of each sighting.
        pixel: (M, 2) float64.
        information: (M, 2, 2) float64.
    """

    host: np.ndarray
    host_ray: np.ndarray
    host_pixel: np.ndarray
    host_information: np.ndarray
    idepth: np.ndarray
    first: np.ndarray
    target: np.ndarray
    pixel: np.ndarray
    information: np.ndarray

    @property
    def point(self) -> np.ndarray:
        """(M,) int64 point of each sighting."""
        return np.repeat(np.arange(len(self.host)), np.diff(self.first))


class _Sightings(NamedTuple):
    """Corners of a host in one target; pixels are those of the undistorted images."""

    target: int
    corners: np.ndarray  # (n,) numbers
    position: np.ndarray  # (n, 2)
    information: np.ndarray  # (n, 2, 2)
    own: np.ndarray  # (n, 2, 2)


def follow(keyframes: Iterable[SeenKeyframe], lens: LensCamera, corners: int = CORNERS) -> Tracks:
    """Find corners in all keyframes and follow them.

    Args:
        keyframes: in order. They are taken one by one, and TARGETS of them are kept.
        lens: with which their images were undistorted.
        corners: at most so many of each keyframe.
    """
    waiting: Deque[Tuple[int, SeenKeyframe, np.ndarray]] = deque()
    parts: List[Tracks] = []
    for number, keyframe in enumerate(keyframes):
        waiting.append((number, keyframe, _flat(keyframe)))
        if len(waiting) > TARGETS:
            parts += _of_host(waiting, lens, corners)
            waiting.popleft()
    while waiting:
        parts += _of_host(waiting, lens, corners)
        waiting.popleft()
    return _joined(parts)


def _flat(keyframe: SeenKeyframe) -> np.ndarray:
    return np.ascontiguousarray(keyframe.image, np.float32).ravel()


def _of_host(waiting: Sequence[Tuple[int, SeenKeyframe, np.ndarray]], lens: LensCamera, most: int) -> List[Tracks]:
    number, host, flat = waiting[0]
    corners, idepth = _corners(host, most)
    if not len(corners):
        return []
    height, width = host.image.shape
    offsets, following = np.zeros((len(corners), 2)), np.ones(len(corners), bool)
    found: List[_Sightings] = []
    for target, keyframe, image in list(waiting)[1:]:
        if keyframe.segment != host.segment:
            break
        predicted, warps = _predicted(host, keyframe, corners, idepth)
        guesses = np.where(following[:, None], predicted + offsets, np.nan)
        position, information, own = align_patches(flat, image, width, height, corners, warps, guesses)
        following = np.isfinite(position[:, 0])
        offsets = position - predicted
        if not following.any():
            break
        kept = np.flatnonzero(following)
        found.append(_Sightings(target, kept, position[kept], information[kept], own[kept]))
    return [] if not found else [_tracks(number, host, corners, idepth, found, lens)]


def _corners(keyframe: SeenKeyframe, most: int) -> Tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2) int64 of corners, and their inverse depths (n,) by the nearest points of the map."""
    height, width = keyframe.image.shape
    mask = np.zeros((height, width), np.uint8)
    mask[BORDER_PX : height - BORDER_PX, BORDER_PX : width - BORDER_PX] = 1
    found = cv2.goodFeaturesToTrack(keyframe.image, most, QUALITY, width / SPREAD, mask=mask, blockSize=2 * RADIUS + 1)
    if found is None or len(keyframe.points) < NEIGHBOURS:
        return np.zeros((0, 2), np.int64), np.zeros(0)
    corners = np.rint(found.reshape(-1, 2)).astype(np.int64)
    points = keyframe.points.astype(np.float64)
    u, v = pixels_at(Intrinsics(*keyframe.camera.parameters), *(points[:, :2] / points[:, 2:]).T)
    apart, nearest = cKDTree(np.column_stack([u, v])).query(corners, NEIGHBOURS)
    near = apart[:, 0] < DEPTH_REACH * width
    return corners[near], np.median(1.0 / points[nearest, 2], axis=1)[near]


def _predicted(
    host: SeenKeyframe, target: SeenKeyframe, corners: np.ndarray, idepth: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Where the target's image should show corners (n, 2), nan behind it, and what a pixel is there, (n, 2, 2)."""
    T = se3.inverse(target.T_world_camera) @ host.T_world_camera

    def seen(pixels: np.ndarray) -> np.ndarray:
        moved = viewing_rays(host.camera.parameters, *pixels.T) @ T[:3, :3].T + idepth[:, None] * T[:3, 3]
        moved[moved[:, 2] < 0.1] = np.nan
        return np.column_stack(pixels_at(Intrinsics(*target.camera.parameters), *(moved[:, :2] / moved[:, 2:]).T))

    middle = corners.astype(np.float64)
    warps = np.stack([seen(middle + step) - seen(middle - step) for step in STEP_PX * np.eye(2)], axis=-1)
    return seen(middle), np.ascontiguousarray(warps)  # divided by 2 STEP_PX, which is 1


def _tracks(
    number: int,
    host: SeenKeyframe,
    corners: np.ndarray,
    idepth: np.ndarray,
    found: Sequence[_Sightings],
    lens: LensCamera,
) -> Tracks:
    """The sightings of one host, sorted by point, in raw pixels."""
    index = np.concatenate([sightings.corners for sightings in found])
    order = np.argsort(index, kind="stable")
    points, counts = np.unique(index, return_counts=True)
    first = np.concatenate([[0], np.cumsum(counts)])
    target = np.concatenate([np.full(len(s.corners), s.target) for s in found])[order]
    position = np.concatenate([s.position for s in found])[order]
    information = np.concatenate([s.information for s in found])[order]
    own = np.concatenate([s.own for s in found])[order]
    pixel, information = _raw(lens, host.camera, position, information)
    at_host = corners[points].astype(np.float64)
    host_pixel, host_information = _raw(lens, host.camera, at_host, own[first[:-1]])
    ray = np.column_stack(normalized(Intrinsics(*host.camera.parameters), *at_host.T))
    hosts = np.full(len(points), number)
    return Tracks(
        hosts, ray, host_pixel, host_information, idepth[points], first, target, pixel, information
    )  # fmt: skip


def _raw(
    lens: LensCamera, camera: PinholeCamera, pixels: np.ndarray, information: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """Raw pixels of undistorted ones (n, 2), and their information."""

    def raw(at: np.ndarray) -> np.ndarray:
        return pixels_of(lens, np.column_stack(normalized(Intrinsics(*camera.parameters), *at.T)))

    derivative = np.stack([raw(pixels + step) - raw(pixels - step) for step in STEP_PX * np.eye(2)], axis=-1)
    back = np.linalg.inv(derivative)
    return raw(pixels), np.swapaxes(back, 1, 2) @ information @ back


def _joined(parts: Sequence[Tracks]) -> Tracks:
    if not parts:
        none, pair = np.zeros(0, np.int64), np.zeros((0, 2))
        return Tracks(
            none, pair, pair, np.zeros((0, 2, 2)), np.zeros(0), np.zeros(1, np.int64), none, pair, np.zeros((0, 2, 2))
        )
    starts = np.cumsum([0, *(part.first[-1] for part in parts)])
    first = np.concatenate([*(part.first[:-1] + start for part, start in zip(parts, starts)), starts[-1:]])

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts])

    return Tracks(
        host=all_of("host"),
        host_ray=all_of("host_ray"),
        host_pixel=all_of("host_pixel"),
        host_information=all_of("host_information"),
        idepth=all_of("idepth"),
        first=first,
        target=all_of("target"),
        pixel=all_of("pixel"),
        information=all_of("information"),
    )
