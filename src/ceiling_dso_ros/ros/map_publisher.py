# SPDX-License-Identifier: BSD-3-Clause
"""Publishes dso_node's map for display; computed only if somebody subscribes."""

import time

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from ceiling_dso_ros.dso import OdometryStatus, PinholeCamera
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import Intrinsics, pixels
from ceiling_dso_ros.dso.mapping.map_snapshot import MapPoints

POINT_STEP = 16  # bytes of a point
FIELDS = [PointField(name, 4 * index, PointField.FLOAT32, 1) for index, name in enumerate(("x", "y", "z", "intensity"))]
NEAR_AND_FAR = (0.4, 2.5)  # VO units, first and last colour of the depths


class MapPublisher:
    """The topics `visual_odometry/points` and `visual_odometry/debug_image`.

    Attributes:
        period_s: shortest time between two messages of a topic, of the wall clock.
    """

    def __init__(self, period_s: float = 0.2) -> None:
        self.period_s = period_s
        self._points = rospy.Publisher("visual_odometry/points", PointCloud2, queue_size=1)
        self._image = rospy.Publisher("visual_odometry/debug_image", Image, queue_size=1)
        self._sent_s = {self._points: -np.inf, self._image: -np.inf}

    def wants(self, status: OdometryStatus) -> bool:
        """Whether `publish` has anything to publish."""
        return (bool(status.keyframes) and self._due(self._points)) or self._due(self._image)

    def publish(
        self, header: Header, camera_frame_id: str, image: np.ndarray, camera: PinholeCamera, status: OdometryStatus,
        points: MapPoints,
    ) -> None:  # fmt: skip
        """Publish what is wanted.

        Args:
            header: stamp of the image and the world frame.
            camera_frame_id: optical frame of the camera.
            image: (height, width) that was tracked, grey levels.
            camera: with which the image was taken.
            status: result of the odometry for the image.
            points: of the window.
        """
        if status.keyframes and self._due(self._points):
            self._send(self._points, point_cloud(header, points))
        if self._due(self._image):
            drawn = draw_points(image, camera, status, points)
            self._send(self._image, colour_image(Header(stamp=header.stamp, frame_id=camera_frame_id), drawn))

    def _due(self, publisher: rospy.Publisher) -> bool:
        return publisher.get_num_connections() > 0 and time.monotonic() >= self._sent_s[publisher] + self.period_s

    def _send(self, publisher: rospy.Publisher, message: object) -> None:
        publisher.publish(message)
        self._sent_s[publisher] = time.monotonic()


def point_cloud(header: Header, points: MapPoints) -> PointCloud2:
    """sensor_msgs/PointCloud2 with x, y, z and the grey level as intensity."""
    table = np.column_stack([points.positions, points.grey]).astype(np.float32)
    return PointCloud2(
        header=header,
        height=1,
        width=len(table),
        fields=FIELDS,
        point_step=POINT_STEP,
        row_step=POINT_STEP * len(table),
        data=table.tobytes(),
        is_dense=True,
    )


def draw_points(image: np.ndarray, camera: PinholeCamera, status: OdometryStatus, points: MapPoints) -> np.ndarray:
    """The image with the window's points coloured by depth and the state, (height, width, 3) uint8, blue first."""
    drawn = cv2.cvtColor(np.clip(image, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    if status.T_world_camera is not None:
        T = se3.inverse(status.T_world_camera)
        x, y, z = T[:3, :3] @ points.positions.T + T[:3, 3:]
        seen = z > 1e-3
        u, v = pixels(Intrinsics(*camera.parameters), x[seen] / z[seen], y[seen] / z[seen])
        near, far = 1.0 / np.array(NEAR_AND_FAR)
        shades = np.clip(255.0 * (1.0 / z[seen] - far) / (near - far), 0, 255).astype(np.uint8)
        colours = cv2.applyColorMap(shades.reshape(-1, 1), cv2.COLORMAP_JET).reshape(-1, 3)
        inside = (u >= 1) & (u < camera.width - 2) & (v >= 1) & (v < camera.height - 2)
        u, v, colours = u[inside].round().astype(int), v[inside].round().astype(int), colours[inside]
        for du in (-1, 0, 1):
            for dv in (-1, 0, 1):
                drawn[v + dv, u + du] = colours
    text = status.message or f"{status.state.value}, {status.active_points} points"
    cv2.putText(drawn, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 255, 255), 1, cv2.LINE_AA)
    return drawn


def colour_image(header: Header, image: np.ndarray) -> Image:
    """sensor_msgs/Image, bgr8."""
    height, width, _ = image.shape
    return Image(header, height, width, "bgr8", 0, 3 * width, np.ascontiguousarray(image).tobytes())
