# SPDX-License-Identifier: BSD-3-Clause
"""What the map keeps of a keyframe: a small image, points and described corners in metres, and the metric pose.

All points are in the upright frame: base_link turned so that its z is the normal of the plane in which the robot drives
(`fusion.tilt`). Two views of one place then differ by a rotation about z and a shift along x and y, and a point keeps
its height, whatever the mount of the camera is wrong by, and though the robot shakes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import Intrinsics, viewing_rays
from ceiling_dso_ros.dso.geometry.projection import pixels as pixels_of
from ceiling_dso_ros.fusion.tilt import Tilt, upright_rotation
from ceiling_dso_ros.slam.matching_kernels import nearest_depths, self_similar

IMAGE_WIDTH_PX = 240  # largest of the kept image
CORNERS_WIDTH_PX = 480  # largest of the image in which corners are found
MOST_CORNERS = 600
MOST_POINTS = 1000
FAST_THRESHOLD = 7  # grey levels
SELF_SIMILAR_BITS = 30  # of 256: a corner with a second one as similar as this in its own image says nothing of a place
BESIDE_PX = 6.0  # closer corners are the same one
DEPTH_REACH_PX = 16.0  # between a corner and the points that give its depth
DEPTH_NEIGHBOURS = 3


class Corners(NamedTuple):
    """Described corners.

    Attributes:
        position: (K, 3) float32 in the upright frame, metres.
        descriptor: (K, 4) uint64, 256 bits of ORB.
    """

    position: np.ndarray
    descriptor: np.ndarray


@dataclass(frozen=True)
class RecordCamera:
    """The camera of the records.

    Attributes:
        camera: of the kept images.
        T_base_camera: (4, 4) float64 mount.
    """

    camera: PinholeCamera
    T_base_camera: np.ndarray

    @classmethod
    def of(cls, camera: PinholeCamera, T_base_camera: np.ndarray) -> "RecordCamera":
        """Of the images of a `KeyframeView`, or of undistorted ones that are as small."""
        return cls(shrunk(camera, _factor(camera.width, IMAGE_WIDTH_PX)), np.asarray(T_base_camera, np.float64))

    def same_as(self, other: "RecordCamera") -> bool:
        """Whether records of both can be compared: the same camera and mount, up to rounding."""
        mine, its = self.camera, other.camera
        return (
            (mine.width, mine.height) == (its.width, its.height)
            and np.allclose(mine.parameters, its.parameters, rtol=1e-3)
            and np.allclose(self.T_base_camera, other.T_base_camera, atol=2e-3)
        )


@dataclass(frozen=True)
class KeyframeRecord:
    """One keyframe, about 80 kB.

    Attributes:
        stamp_ns: of its image, nanoseconds.
        pose: (3,) float64 x, y, yaw of base_link in odom, metres and rad.
        step_covariance: (3, 3) float64 of the motion from the record before, as in `fusion.planar`.
        image: (height, width) uint8, undistorted.
        points: (N, 3) float32 of the ceiling in the upright frame, metres.
        corners: described corners with known depth, without self-similar ones.
        tilt: of base_link against the upright frame.
    """

    stamp_ns: int
    pose: np.ndarray
    step_covariance: np.ndarray
    image: np.ndarray
    points: np.ndarray
    corners: Corners
    tilt: Tilt

    @property
    def height_m(self) -> float:
        """Median height of the points above the floor, metres."""
        return float(np.median(self.points[:, 2]))

    @property
    def brightness(self) -> float:
        """Mean grey level."""
        return float(self.image.mean())


@dataclass(frozen=True)
class KeyframeView:
    """What the odometry hands over of a keyframe that leaves its window.

    Attributes:
        stamp_ns: of its image, nanoseconds.
        keyframe_id: as the odometry counts.
        image: (height, width) uint8, undistorted, at most CORNERS_WIDTH_PX wide.
        camera: of that image.
        points: (N, 3) float32 in the camera's frame, z > 0, in view, VO units.
    """

    stamp_ns: int
    keyframe_id: int
    image: np.ndarray
    camera: PinholeCamera
    points: np.ndarray

    @classmethod
    def of(
        cls, stamp_ns: int, keyframe_id: int, image: np.ndarray, camera: PinholeCamera, points: np.ndarray
    ) -> "KeyframeView":
        """Make the image smaller: (height, width) float32, undistorted, grey levels 0..255."""
        factor = _factor(camera.width, CORNERS_WIDTH_PX)
        small = np.asarray(points, np.float32)
        return cls(stamp_ns, keyframe_id, _reduced(image, factor), handed_over(camera), small)


@dataclass(frozen=True)
class View:
    """What a camera saw at a keyframe, in the camera's frame and in any unit of length.

    Attributes:
        image: (height, width) uint8 of the kept size.
        points: (N, 3) float64.
        corners: as those of a record, but in the camera's frame.
    """

    image: np.ndarray
    points: np.ndarray
    corners: Corners

    @classmethod
    def of(cls, image: np.ndarray, camera: PinholeCamera, points: np.ndarray) -> "View":
        """Reduce an image and describe its corners.

        Args:
            image: (height, width) float32 or uint8, undistorted, grey levels 0..255.
            camera: of the image.
            points: (N, 3) points in the camera's frame, z > 0, in view.
        """
        factor = _factor(camera.width, CORNERS_WIDTH_PX)
        return cls(
            _reduced(image, _factor(camera.width, IMAGE_WIDTH_PX)),
            points[_spread(len(points), MOST_POINTS)],
            _described(_reduced(image, factor), shrunk(camera, factor), points),
        )

    def record(
        self,
        stamp_ns: int,
        metres_per_unit: float,
        T_base_camera: np.ndarray,
        pose: np.ndarray,
        step_covariance: np.ndarray,
        tilt: Tilt,
    ) -> KeyframeRecord:
        """The record, in metres and upright; arguments as the attributes of KeyframeRecord."""
        T = T_upright_camera(tilt, T_base_camera)

        def upright(positions: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(metres_per_unit * positions @ T[:3, :3].T + T[:3, 3], np.float32)

        corners = Corners(upright(self.corners.position), self.corners.descriptor)
        return KeyframeRecord(stamp_ns, pose, step_covariance, self.image, upright(self.points), corners, tilt)


def T_upright_camera(tilt: Tilt, T_base_camera: np.ndarray) -> np.ndarray:
    """(4, 4) pose of the camera in the upright frame, whose origin is that of base_link."""
    T = np.eye(4)
    T[:3, :3] = upright_rotation(tilt.angles)
    return T @ T_base_camera


def handed_over(camera: PinholeCamera) -> PinholeCamera:
    """The camera of the images of a `KeyframeView`, from that of the odometry's images."""
    return shrunk(camera, _factor(camera.width, CORNERS_WIDTH_PX))


def shrunk(camera: PinholeCamera, factor: int) -> PinholeCamera:
    """The camera of images whose pixels are the means of factor x factor pixels."""
    cx, cy = (camera.cx + 0.5) / factor - 0.5, (camera.cy + 0.5) / factor - 0.5
    return PinholeCamera(
        camera.fx / factor, camera.fy / factor, cx, cy, camera.width // factor, camera.height // factor
    )


def _factor(width: int, largest: int) -> int:
    return max(1, -(-width // largest))


def _reduced(image: np.ndarray, factor: int) -> np.ndarray:
    height, width = (side // factor for side in image.shape)
    whole = np.asarray(image[: height * factor, : width * factor], np.float32)
    small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def _spread(count: int, most: int) -> np.ndarray:
    """At most so many indices, evenly over all."""
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)


def _described(image: np.ndarray, camera: PinholeCamera, points: np.ndarray) -> Corners:
    """Corners (in the camera's frame) whose depth the points tell and that are not self-similar."""
    none = Corners(np.zeros((0, 3)), np.zeros((0, 4), np.uint64))
    orb = cv2.ORB.create(MOST_CORNERS, nlevels=1, edgeThreshold=16, patchSize=31, fastThreshold=FAST_THRESHOLD)
    found, descriptors = orb.detectAndCompute(image, None)
    if descriptors is None or not len(points):
        return none
    pixels = np.array([corner.pt for corner in found], np.float64)
    bits = np.ascontiguousarray(descriptors).view(np.uint64).reshape(-1, 4)
    depth = _depths(pixels, camera, points)
    kept = np.isfinite(depth) & ~self_similar(bits, pixels, SELF_SIMILAR_BITS, BESIDE_PX)
    rays = viewing_rays(camera.parameters, *pixels.T)
    return Corners((rays * depth[:, None])[kept], bits[kept])


def _depths(pixels: np.ndarray, camera: PinholeCamera, points: np.ndarray) -> np.ndarray:
    """Depth of (K, 2) pixels, the median of the nearest points; nan where there are none, (K,)."""
    u, v = pixels_of(Intrinsics(*camera.parameters), *(points[:, :2] / points[:, 2:]).T)
    depths = nearest_depths(pixels, u, v, np.ascontiguousarray(points[:, 2]), DEPTH_NEIGHBOURS, DEPTH_REACH_PX)
    result = np.full(len(pixels), np.nan)
    known = np.isfinite(depths).any(axis=1)
    result[known] = np.nanmedian(depths[known], axis=1)
    return result
