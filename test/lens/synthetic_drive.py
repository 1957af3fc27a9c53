# SPDX-License-Identifier: BSD-3-Clause
"""A drive at the level of sightings: points over a path, seen by a lens, with the wheels' motion; no images."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.parameters import pixels_of, rays_of
from ceiling_dso_ros.lens.tracks import SeenKeyframe, Tracks

NOISE_PX = 0.05
POINTS, TARGETS = 25, 6  # of a keyframe
WHEEL_HZ, START_NS = 50, 1_000_000_000
UNIT_M = 4.0

LENS = LensCamera("RadTan", 212.0, 213.0, 213.0, 118.0, (0.02, -0.01, 0.0, 0.0), 424, 240)


def mount(roll_deg=1.3, pitch_deg=-0.9, yaw_deg=-89.0, xyz=(0.18, 0.04, 0.62)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", (yaw_deg, pitch_deg, roll_deg), degrees=True).as_matrix()
    T[:3, 3] = xyz
    return T


ROBOT = RobotModel(mount(0.0, 0.0, -90.0, (0.16, 0.0, 0.62)), 0.485, (0.098, 0.098))


@dataclass
class SyntheticDrive:
    """Keyframes (without images), their tracks, the wheels' steps, and the truth."""

    keyframes: list
    tracks: Tracks
    steps: list
    T_world_base: np.ndarray
    T_base_camera: np.ndarray
    lens: LensCamera


def path_at(time_s):
    """(n, 3) of a drive that winds and turns; x, y, yaw."""
    fine = np.arange(0.0, time_s.max() + 0.02, 0.01)
    speed = 0.5 + 0.2 * np.sin(0.7 * fine)
    rate = 0.7 * np.sin(0.45 * fine) + 0.25 * np.sin(1.3 * fine)
    yaw = np.cumsum(rate) * 0.01
    middle = yaw - 0.005 * rate
    x, y = np.cumsum(speed * np.cos(middle)) * 0.01, np.cumsum(speed * np.sin(middle)) * 0.01
    return np.column_stack([np.interp(time_s, fine, column) for column in (x, y, yaw)])


def rough_poses(path, rng, tilt_rad=1e-3, height_m=3e-4):
    poses = np.tile(np.eye(4), (len(path), 1, 1))
    tilts = rng.normal(0.0, tilt_rad, (len(path), 2))
    poses[:, :3, :3] = Rotation.from_euler("ZYX", np.column_stack([path[:, 2], tilts])).as_matrix()
    poses[:, :2, 3] = path[:, :2]
    poses[:, 2, 3] = rng.normal(0.0, height_m, len(path))
    return poses


def synthetic_drive(seed, duration_s=24.0, lens=LENS, noise_px=NOISE_PX, offset_s=0.0, slip_m=0.0):
    """A drive; camera stamps are early by offset_s, so that this is the camera's time offset."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.5, duration_s - 0.5, 0.25)
    poses, T_base_camera = rough_poses(path_at(times), rng), mount()
    cameras = poses @ T_base_camera
    stamps = [START_NS + int(1e9 * (time - offset_s)) for time in times]
    in_units = np.linalg.inv(cameras[0]) @ cameras
    in_units[:, :3, 3] /= UNIT_M
    keyframes = [SeenKeyframe(stamp, 0, T, None, None, np.zeros((0, 3))) for stamp, T in zip(stamps, in_units)]
    return SyntheticDrive(
        keyframes, _tracks(rng, cameras, lens, noise_px), _steps(rng, duration_s, slip_m), poses, T_base_camera, lens
    )


def _tracks(rng, cameras, lens, noise_px):
    parts = {name: [] for name in ("host", "ray", "pixel", "idepth", "target", "seen")}
    first = [0]
    for host in range(len(cameras) - 1):
        pixel = rng.uniform([8, 8], [lens.width - 9, lens.height - 9], (POINTS, 2))
        ray = rays_of(lens, pixel, (pixel - [lens.cx, lens.cy]) / [lens.fx, lens.fy])
        depth = rng.uniform(3.0, 5.0, POINTS)
        points = (
            np.column_stack([ray, np.ones(POINTS)]) * depth[:, None] @ cameras[host, :3, :3].T + cameras[host, :3, 3]
        )
        for p in range(POINTS):
            count = 0
            for target in range(host + 1, min(host + 1 + TARGETS, len(cameras))):
                q = cameras[target, :3, :3].T @ (points[p] - cameras[target, :3, 3])
                at = pixels_of(lens, (q[:2] / q[2])[None])[0]
                if not (8 < at[0] < lens.width - 9 and 8 < at[1] < lens.height - 9):
                    break
                parts["target"].append(target)
                parts["seen"].append(at + rng.normal(0.0, noise_px, 2))
                count += 1
            if count:
                first.append(first[-1] + count)
                parts["host"].append(host)
                parts["ray"].append(ray[p])
                parts["pixel"].append(pixel[p] + rng.normal(0.0, noise_px, 2))
                parts["idepth"].append(UNIT_M / depth[p])
    arrays = {name: np.array(values) for name, values in parts.items()}
    information = np.eye(2) / noise_px**2
    return Tracks(
        arrays["host"], arrays["ray"], arrays["pixel"], np.tile(information, (len(arrays["host"]), 1, 1)),
        arrays["idepth"] * rng.normal(1.0, 0.02, len(arrays["idepth"])), np.array(first), arrays["target"],
        arrays["seen"], np.tile(information, (len(arrays["target"]), 1, 1)),
    )  # fmt: skip


def _steps(rng, duration_s, slip_m, noise_m=1e-4):
    """Of wheels with the nominal dimensions."""
    times = np.arange(0.0, duration_s, 1.0 / WHEEL_HZ)
    path = path_at(times)
    moved = np.diff(path, axis=0)
    forward = np.hypot(*moved[:, :2].T)
    half = 0.5 * ROBOT.wheel_base_m * moved[:, 2]
    wheels = np.column_stack([forward - half, forward + half])
    wheels += rng.normal(0.0, 1.0, wheels.shape) * noise_m * np.sqrt(np.abs(wheels))
    middle = len(wheels) // 2
    wheels[middle : middle + 10, 0] += slip_m / 10  # the left one turns further
    angles = np.vstack([np.zeros(2), np.cumsum(wheels, axis=0)]) / 0.098
    odometry = WheelOdometry(ROBOT, WheelConfig())
    steps = (odometry.add_angles(START_NS + int(1e9 * t), *angle) for t, angle in zip(times, angles.tolist()))
    return [step for step in steps if step is not None]
