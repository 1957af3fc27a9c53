# SPDX-License-Identifier: BSD-3-Clause
"""Records of a flat painted ceiling, made in milliseconds."""

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.slam.records import RecordCamera, T_upright_camera, View

CAMERA = PinholeCamera(212.0, 212.0, 211.5, 119.5, 424, 240)
HEIGHT_M = 3.0
TEXEL_M = 0.015
SIZE_M = (16.0, 12.0)
UPRIGHT = Tilt(np.zeros(2), np.full(2, 1e-3))
STEP_SIGMAS = np.array([0.012, 0.012, 0.002])  # of the odometry from keyframe to keyframe


def mount(roll=0.02, pitch=-0.015, yaw=-1.5):
    """T_base_camera of a camera that looks up, a little tilted."""
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    T = planar.lift(np.array([0.18, 0.04, yaw]))
    T[:3, :3] = T[:3, :3] @ [[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]] @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    T[2, 3] = 0.5
    return T


RECORD_CAMERA = RecordCamera.of(CAMERA, mount())


def paint(seed, period_m=None):
    """A texture of rectangles and stains, (H, W) float32; with a period it repeats along both axes."""
    rng = np.random.default_rng(seed)
    width, height = (round(side / TEXEL_M) for side in (SIZE_M if period_m is None else (period_m, period_m)))
    image = np.full((height, width), 110.0, np.float32)
    for _ in range(round(14 * width * height * TEXEL_M**2)):
        u, v = rng.integers(0, [width, height])
        w, h = rng.integers(4, 40, 2)
        image[v : v + h, u : u + w] += rng.uniform(-60, 60)
    image = cv2.GaussianBlur(np.clip(image, 5, 250), (0, 0), 1.5)
    if period_m is not None:
        image = np.tile(image, [int(np.ceil(side / period_m)) for side in SIZE_M[::-1]])
    return image


def seen(texture, pose, stamp_ns=0, seed=0, camera=RECORD_CAMERA, gain=1.0, leans=(0.0, 0.0)):
    """Image and points, in the camera's frame, of a robot in the hall, which leans by a roll and a pitch."""
    rng = np.random.default_rng([seed, stamp_ns])
    T_base_camera = T_upright_camera(Tilt(np.asarray(leans), np.zeros(2)), camera.T_base_camera)
    T_camera_world = np.linalg.inv(planar.lift(np.asarray(pose, float)) @ T_base_camera)
    plane = np.column_stack([T_camera_world[:3, :2], T_camera_world[:3, 2] * HEIGHT_M + T_camera_world[:3, 3]])
    low = -0.5 * TEXEL_M * np.array(texture.shape[::-1])
    to_metres = np.array([[TEXEL_M, 0, low[0]], [0, TEXEL_M, low[1]], [0, 0, 1]])
    warp = CAMERA.matrix @ plane @ to_metres
    image = cv2.warpPerspective(texture, warp, (CAMERA.width, CAMERA.height), borderMode=cv2.BORDER_REPLICATE)
    image = np.clip(gain * image + rng.normal(0.0, 1.5, image.shape), 0, 255).astype(np.float32)
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(6, 420, 9.0), np.arange(6, 236, 9.0)))
    rays = np.column_stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))])
    normal, offset = T_camera_world[:3, 2], HEIGHT_M + T_camera_world[:3, 3] @ T_camera_world[:3, 2]
    depth = offset / (rays @ normal) * (1.0 + 0.005 * rng.standard_normal(len(u)))
    return image, rays * depth[:, None]


def record(
    texture, pose, stamp_ns=0, odom=None, seed=0, camera=RECORD_CAMERA, gain=1.0, leans=(0.0, 0.0), tilt=UPRIGHT
):
    """What a map keeps of it; `odom` is where the odometry believes the robot to be."""
    image, points = seen(texture, pose, stamp_ns, seed, camera, gain, leans)
    view = View.of(image, CAMERA, points)
    believed = np.asarray(pose if odom is None else odom, float)
    return view.record(stamp_ns, 1.0, camera.T_base_camera, believed, np.diag(STEP_SIGMAS**2), tilt)


def drifted(poses, start=(0.0, 0.0, 0.0), seed=0):
    """What an odometry that begins at `start` makes of true poses."""
    rng = np.random.default_rng(seed)
    odom = [np.asarray(start, float)]
    for before, after in zip(poses, poses[1:]):
        step = planar.compose(planar.between(before, after), rng.normal(0.0, STEP_SIGMAS))
        odom.append(planar.compose(odom[-1], step))
    return odom


def round_trip(radius_m, laps, count, centre=(0.0, 0.0), sense=1.0):
    """(3,) poses on a circle, `count` in a lap."""
    angle = sense * np.linspace(0.0, 2 * np.pi * laps, round(count * laps) + 1)
    x, y = centre[0] + radius_m * np.cos(angle), centre[1] + radius_m * np.sin(angle)
    yaw = angle + sense * np.pi / 2
    return [np.array([a, b, planar.wrap(c)]) for a, b, c in zip(x, y, yaw)]
