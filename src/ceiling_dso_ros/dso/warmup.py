# SPDX-License-Identifier: BSD-3-Clause
"""Compile and cache every kernel before the first run: `python3 -m ceiling_dso_ros.dso.warmup`."""

import sys
from functools import partial
from pathlib import Path
from typing import Callable, Optional

import numpy as np

from ceiling_dso_ros.dso.compute.jit import cache_folders
from ceiling_dso_ros.dso.compute.kernel_cache import compile_if_missing, complete_marker, fill_cache
from ceiling_dso_ros.dso.config import OdometryConfig, WindowConfig
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.dso.images.interpolation import sample
from ceiling_dso_ros.dso.odometry import DirectOdometry
from ceiling_dso_ros.dso.stereo.rig import StereoRig

MAX_FRAMES = 80
KEYFRAMES = 6  # enough that keyframes are marginalised
STEP = 0.012  # depths from one image to the next
BASELINE = 0.04  # depths, of a second camera
NOISE = 3.0  # grey levels, that are smoothed


def textured_plane(camera: PinholeCamera, shift: float) -> np.ndarray:
    """A wavy surface at about unit depth, seen after moving sideways by `shift` depths; (height, width) float32."""
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y, _ = np.moveaxis(viewing_rays(camera.parameters, u, v), -1, 0)
    x = x + shift * (1.0 + 0.2 * np.sin(9.0 * y))
    waves = np.random.default_rng(0).normal(size=(16, 3)) * (45.0, 45.0, 3.0)
    grey = sum(np.cos(fx * x + fy * y + phase) for fx, fy, phase in waves)
    return (120.0 + 9.0 * grey).astype(np.float32)


def warm_up() -> int:
    """Run a short sequence through the odometry; returns the number of keyframes it made."""
    camera = PinholeCamera(200.0, 200.0, 159.5, 119.5, 320, 240)
    window = WindowConfig(max_keyframes=3, min_keyframes=2, candidate_points=300, active_points=400)
    T_left_right = np.eye(4)
    T_left_right[0, 3] = BASELINE
    odometry = DirectOdometry(camera, OdometryConfig(window=window), rig=StereoRig(camera, T_left_right))
    keyframes = 0
    for frame in range(MAX_FRAMES):
        right = partial(textured_plane, camera, STEP * frame + BASELINE)
        keyframes += odometry.track(textured_plane(camera, STEP * frame), frame, right=right).is_keyframe
        if keyframes == KEYFRAMES:
            break
    odometry.track(np.full((camera.height, camera.width), 255.0, np.float32), MAX_FRAMES)  # as by a flash
    odometry.reset()
    return min(keyframes, _warm_up_on_vehicle(odometry))


def _warm_up_on_vehicle(odometry: DirectOdometry) -> int:
    """The same with a noisy camera whose motion is predicted, in a plane; returns as `warm_up`."""
    camera, rng = odometry.camera, np.random.default_rng(0)
    keyframes, predict_from = 0, 0
    for frame in range(MAX_FRAMES):
        image = textured_plane(camera, STEP * frame)
        image += rng.normal(0.0, NOISE, image.shape).astype(np.float32)
        T_start_end = np.eye(4)
        T_start_end[0, 3] = STEP * (frame - predict_from)
        motion = CameraMotion(T_start_end, 1e-6 * np.eye(6), metric=True, normal=np.array([0.0, 0.0, 1.0]))
        status = odometry.track(image, frame, prediction=motion if frame > 0 else None)
        keyframes, predict_from = keyframes + status.is_keyframe, status.predict_from_ns
        if keyframes == KEYFRAMES:
            break
    return keyframes


def load_kernels(tell: Callable[[str], None]) -> None:
    """Have every kernel ready.

    Args:
        tell: see `compile_if_missing`.
    """
    compile_if_missing(_marker(), __name__, tell)
    warm_up()


def _marker() -> Optional[Path]:
    """The file that says that the cache is complete; None where nothing can be cached."""
    return complete_marker(sample, [Path(__file__).parent], "kernels")


def main() -> int:
    """Entry point."""
    marker = _marker()
    folders = cache_folders() if marker is None else {marker.parent, *cache_folders()}
    return fill_cache(marker, folders, lambda: warm_up() == KEYFRAMES)


if __name__ == "__main__":
    sys.exit(main())
