# SPDX-License-Identifier: BSD-3-Clause
"""Keyframe records of a simulated drive without its odometry: what maps are judged by in many halls.

A whole drive takes minutes to render and track. Here only the images at the keyframes are rendered, with their true
depth. The points are those that an odometry would choose, with an error of their depth. The motion is the true one with
the drift of an odometry. So this judges the map, not what it is made of.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import List, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import viewing_rays
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.tilt import Tilt
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.simulation import Simulation
from ceiling_dso_ros.slam.records import KeyframeRecord, RecordCamera, View

SAMPLING_S = 0.02
SESSION_NS = 10**12  # between the stamps of sessions
CELL_PX = 8
LEAST_GRADIENT = 6.0  # grey levels a pixel
DEPTH_SIGMA = 0.01  # relative
STEP_SIGMAS = np.array([2e-3, 2e-3, 2e-4])  # of the odometry after a metre, metres and rad
TILT_SIGMA_RAD = 7e-4  # with which the fusion tells the tilt of a robot that shakes by 2 mrad


@dataclass(frozen=True)
class RenderedKeyframes:
    """A drive with a keyframe every so many metres.

    Attributes:
        config: the drive.
        step_m: between keyframes.
        folder: where the images are kept, because rendering takes long.
    """

    config: SimulationConfig
    step_m: float
    folder: Path

    @property
    def is_periodic(self) -> bool:
        """Whether the roof repeats strictly."""
        return bool(self._simulation.hall.description.get("is_periodic", False))

    @property
    def camera(self) -> RecordCamera:
        """Of the records."""
        return RecordCamera.of(self._pinhole, self._mount)

    @cached_property
    def stamps_ns(self) -> np.ndarray:
        """(N,) int64."""
        first = self.config.session * SESSION_NS
        return np.array([first + self._simulation.image_stamp_ns(time_s) for time_s in self._times_s], np.int64)

    @cached_property
    def true_poses(self) -> np.ndarray:
        """(N, 3) of base_link in the hall."""
        T = self._simulation.robot.T_world_base(self._times_s)
        return np.column_stack([T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])

    def records(self) -> List[KeyframeRecord]:
        """The records, with poses by a drifting odometry that begins at the origin."""
        images, idepths = self._rendered()
        rng = np.random.default_rng([self.config.seed, self.config.session, 5])
        pose, before = np.zeros(3), self.true_poses[0]
        records = []
        drive = self.stamps_ns.tolist(), self.true_poses, self._tilts()
        for stamp_ns, true, tilt, image, idepth in zip(*drive, images, idepths):
            motion = planar.between(before, true)
            sigmas = np.sqrt(np.hypot(*motion[:2])) * STEP_SIGMAS
            pose, before = planar.compose(pose, planar.compose(motion, rng.normal(0.0, 1.0, 3) * sigmas)), true
            view = View.of(image, self._pinhole, _points(image, idepth, self._pinhole, rng))
            records.append(view.record(stamp_ns, 1.0, self._mount, pose, np.diag(sigmas**2), tilt))
        return records

    def _tilts(self) -> List[Tilt]:
        """The true tilts with the errors of a fusion."""
        rng = np.random.default_rng([self.config.seed, self.config.session, 6])
        R = self._simulation.robot.T_world_base(self._times_s)[:, :3, :3]
        true = np.column_stack([np.arctan2(R[:, 2, 1], R[:, 2, 2]), -np.arcsin(R[:, 2, 0])])
        return [Tilt(angles, np.full(2, TILT_SIGMA_RAD)) for angles in rng.normal(true, TILT_SIGMA_RAD)]

    @cached_property
    def _simulation(self) -> Simulation:
        return Simulation(self.config)

    @property
    def _pinhole(self) -> PinholeCamera:
        return self.config.camera.pinhole

    @property
    def _mount(self) -> np.ndarray:
        return self._simulation.robot.true.T_base_camera

    @cached_property
    def _times_s(self) -> np.ndarray:
        times_s = np.arange(0.0, self._simulation.duration_s, SAMPLING_S)
        steps_m = np.hypot(*np.diff(self._simulation.robot.T_world_base(times_s)[:, :2, 3], axis=0).T)
        way_m = np.append(0.0, np.cumsum(steps_m))
        return times_s[np.searchsorted(way_m, np.arange(0.0, way_m[-1], self.step_m))]

    def _rendered(self) -> Tuple[np.ndarray, np.ndarray]:
        """Images (N, H, W) uint8 and inverse depths (N, H, W) float16."""
        config = self.config
        name = (
            f"{config.sequence}_{config.ceiling}_{config.seed}_{config.session}_{config.duration_s:g}_{self.step_m:g}"
        )
        path = self.folder / f"{name}_{config.camera.width}.npz"
        if not path.exists():
            up = next(iter(self._simulation.cameras))
            images = [self._simulation.images_at(float(t), i).images[up] for i, t in enumerate(self._times_s)]
            idepths = [self._simulation.inverse_depth(float(t)).astype(np.float16) for t in self._times_s]
            self.folder.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_suffix(".part.npz")
            np.savez(unfinished, images=np.array(images), idepths=np.array(idepths))
            unfinished.replace(path)
        with np.load(path) as kept:
            return kept["images"], kept["idepths"]


def _points(image: np.ndarray, idepth: np.ndarray, camera: PinholeCamera, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) points at the steepest pixel of each cell, in the camera's frame, with an error of their depth."""
    grey = image.astype(np.float32)
    steepness = np.hypot(*(cv2.Sobel(grey, cv2.CV_32F, *axis, scale=0.125) for axis in ((1, 0), (0, 1))))
    rows, columns = (side // CELL_PX for side in image.shape)
    cells = steepness[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX)
    within = cells.transpose(0, 2, 1, 3).reshape(rows * columns, -1).argmax(axis=1)
    cell_v, cell_u = np.divmod(np.arange(rows * columns), columns)
    v, u = cell_v * CELL_PX + within // CELL_PX, cell_u * CELL_PX + within % CELL_PX
    seen = idepth[v, u].astype(np.float64)
    kept = (steepness[v, u] > LEAST_GRADIENT) & (seen > 0.0)
    u, v, seen = u[kept], v[kept], seen[kept]
    depth = 1.0 / (seen * (1.0 + DEPTH_SIGMA * rng.standard_normal(len(seen))))
    return viewing_rays(camera.parameters, u, v) * depth[:, None]
