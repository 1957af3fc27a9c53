# SPDX-License-Identifier: BSD-3-Clause
"""From the keyframes of a drive and its wheels to lens, mount, clock and wheel dimensions, with their covariance."""

import math
from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.fusion.calibration import MIN_PAIRS, CalibrationError
from ceiling_dso_ros.fusion.calibration_data import CameraPose, ImagePair, WheelPath, image_pairs
from ceiling_dso_ros.fusion.calibration_problem import PRIOR_SIGMAS
from ceiling_dso_ros.fusion.calibration_slips import WheelSlip, beside, described, follows, slipping
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.wheel_motion import WheelStep
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.adjustment import Adjustment, Noise, Prior, first_noise
from ceiling_dso_ros.lens.floor import WheelPairs
from ceiling_dso_ros.lens.parameters import correctable, vector_of
from ceiling_dso_ros.lens.state import MOUNT, OF_DRIVE, WHEELS, DriveState
from ceiling_dso_ros.lens.tracks import SeenKeyframe, Tracks

# Standard deviations of what is known of a lens before: of cameras of a kind, and of one that was calibrated once.
FOCAL_SIGMA, ASPECT_SIGMA = 0.02, 0.005  # relative: both focal lengths together, and each alone
CENTRE_SIGMA = 0.006  # of the image's width: 5 pixels of 848
RADIAL_SIGMA = 0.1
# The base may shake about any axis, not only about base_link. How far the camera is above it is not known better.
SHAKING_SIGMA_M = 0.3
FIRST_ROUNDS, ROUNDS, SLIP_ROUNDS = 3, 2, 5
LEAST_KEYFRAMES = 20


@dataclass(frozen=True)
class FoundDrive:
    """What fits a drive best.

    Attributes:
        state: the estimate.
        covariance: (15, 15) of the unknowns of the drive, in the order of `state`.
        noise: of the drive.
        slips: times at which the wheels slipped, which are left out.
        pairs, left_out: how many pairs of keyframes were used, and how many were not.
    """

    state: DriveState
    covariance: np.ndarray
    noise: Noise
    slips: Tuple[WheelSlip, ...]
    pairs: int
    left_out: int


def find(
    keyframes: Sequence[SeenKeyframe], tracks: Tracks, steps: Sequence[WheelStep], known: RobotModel,
    guess: RobotModel, known_lens: LensCamera, guess_lens: LensCamera,
) -> FoundDrive:  # fmt: skip
    """Estimate everything.

    Args:
        keyframes: of the drive, in order.
        tracks: their corners.
        steps: of the wheels by the nominal dimensions.
        known: the nominal robot.
        guess: a robot to begin with, as a calibration of the odometry's poses gives it.
        known_lens: the lens of the recording.
        guess_lens: that of the odometry's images, to begin with.

    Raises:
        CalibrationError: there is too little to see, or too little motion.
    """
    if len(keyframes) < LEAST_KEYFRAMES or len(tracks.host) < LEAST_KEYFRAMES:
        raise CalibrationError(
            f"only {len(keyframes)} keyframes with {len(tracks.host)} corners are seen: drive for longer, "
            "add light, or leave the lens as it is with --keep-lens"
        )
    path = WheelPath(steps, known.wheel_base_m)
    wheels = _wheel_pairs(keyframes, path)
    if len(wheels.pairs) < MIN_PAIRS:
        raise CalibrationError(
            f"only {len(wheels.pairs)} pairs of keyframes with motion between them: drive for longer"
        )
    try:
        return _adjusted(keyframes, tracks, wheels, known, guess, known_lens, guess_lens)
    except CalibrationError:
        raise
    except (ValueError, np.linalg.LinAlgError) as error:  # of scipy and of numpy: no finite solution
        raise CalibrationError(f"the images do not tell the lens ({error}); --keep-lens leaves it as it is") from error


def _adjusted(
    keyframes: Sequence[SeenKeyframe], tracks: Tracks, wheels: WheelPairs, known: RobotModel, guess: RobotModel,
    known_lens: LensCamera, guess_lens: LensCamera,
) -> FoundDrive:  # fmt: skip
    state = _first_state(keyframes, tracks, wheels, known, guess, guess_lens)
    adjustment = Adjustment(
        tracks,
        np.array([keyframe.stamp_ns for keyframe in keyframes], np.int64),
        np.array([keyframe.segment for keyframe in keyframes], np.int64),
        wheels,
        prior_of(known, known_lens),
        state.idepth,
    )
    state, noise = adjustment.solve(state, first_noise(), FIRST_ROUNDS)
    follow = follows(wheels.pairs)
    slips = np.zeros(len(follow) + 1, bool)
    for _ in range(SLIP_ROUNDS):
        excess_m, way_m = wheels.excess_m(state, 0.5 * known.wheel_base_m)
        slips = slipping(excess_m, adjustment.used, way_m, follow)
        used = ~beside(slips, follow)
        if (used == adjustment.used).all():
            break
        if np.count_nonzero(used) < max(MIN_PAIRS, len(used) // 2):
            raise CalibrationError(
                f"wheels and camera disagree about {np.count_nonzero(~used)} of {len(used)} pairs of keyframes: the "
                "wheels slip, or the joints or the dimensions are those of another robot"
            )
        adjustment.used = used
        state, noise = adjustment.solve(state, noise, ROUNDS)
    excess_m, _ = wheels.excess_m(state, 0.5 * known.wheel_base_m)
    covariance = adjustment.covariance(state, noise)
    count = int(np.count_nonzero(adjustment.used))
    named = described(wheels.pairs, slips, excess_m)
    return FoundDrive(state, covariance, noise, named, count, len(slips) - count)


def _wheel_pairs(keyframes: Sequence[SeenKeyframe], path: WheelPath) -> WheelPairs:
    poses = [CameraPose(k.stamp_ns, k.segment, k.T_world_camera) for k in keyframes]
    pairs = image_pairs(poses, path)
    number = {keyframe.stamp_ns: index for index, keyframe in enumerate(keyframes)}
    ends = [[number[pair.start_ns], number[pair.end_ns]] for pair in pairs]
    return WheelPairs(path, pairs, np.array(ends, np.int64).reshape(-1, 2))


def _first_state(
    keyframes: Sequence[SeenKeyframe], tracks: Tracks, wheels: WheelPairs, known: RobotModel, guess: RobotModel,
    lens: LensCamera,
) -> DriveState:  # fmt: skip
    """Metric poses and depths from the odometry's, each segment with its scale by the wheels."""
    ratios = [np.divide(*np.array(robot.wheel_radius_m)[::-1]) for robot in (guess, known)]
    of_wheels = np.array(
        [
            guess.camera_time_offset_s,
            math.log(ratios[0] / ratios[1]),
            math.log(guess.wheel_base_m / known.wheel_base_m),
        ]
    )
    mount = guess.T_base_camera
    scales = _scales(wheels.pairs, wheels.wheels.motions(wheels.pairs, *of_wheels), mount)
    typical = float(np.median(list(scales.values())))
    back = np.linalg.inv(mount)
    poses: List[np.ndarray] = []
    origin: Dict[int, np.ndarray] = {}
    for keyframe in keyframes:
        moved = np.linalg.inv(origin.setdefault(keyframe.segment, keyframe.T_world_camera)) @ keyframe.T_world_camera
        moved[:3, 3] *= scales.get(keyframe.segment, typical)
        poses.append(mount @ moved @ back)
    of_host = np.array([scales.get(keyframe.segment, typical) for keyframe in keyframes])
    idepth = tracks.idepth / of_host[tracks.host]
    return DriveState(
        correctable(lens), mount.copy(), of_wheels, np.array(poses), tracks.host_pixel.copy(), tracks.host_ray, idepth
    )


def _scales(pairs: Sequence[ImagePair], motions: np.ndarray, mount: np.ndarray) -> Dict[int, float]:
    """Metres per VO unit of each segment: the median over pairs that move the camera."""
    lever = mount[:2, 3]
    c, s = np.cos(motions[:, 2]), np.sin(motions[:, 2])
    swing = np.column_stack([(c - 1.0) * lever[0] - s * lever[1], s * lever[0] + (c - 1.0) * lever[1]])
    way_m = np.hypot(*(motions[:, :2] + swing).T)
    units = np.array([np.linalg.norm(pair.translation) for pair in pairs])
    segments = np.array([pair.segment for pair in pairs])
    moving = (way_m > 0.02) & (units > 0.0)
    return {
        int(segment): float(np.median((way_m / np.where(moving, units, 1.0))[moving & (segments == segment)]))
        for segment in np.unique(segments[moving])
    }


def prior_of(robot: RobotModel, lens: LensCamera) -> Prior:
    """What is known of a nominal robot and of the lens of a recording."""
    roll_pitch_yaw, position, clock = PRIOR_SIGMAS[:3], PRIOR_SIGMAS[3:5], PRIOR_SIGMAS[5:]
    covariance = np.zeros((OF_DRIVE, OF_DRIVE))
    focal = np.array([lens.fx, lens.fy])
    covariance[:2, :2] = np.outer(focal, focal) * (FOCAL_SIGMA**2 + ASPECT_SIGMA**2 * np.eye(2))
    sigmas = np.concatenate([np.full(2, CENTRE_SIGMA * lens.width), np.full(2, RADIAL_SIGMA)])
    covariance[range(2, 6), range(2, 6)] = sigmas**2
    of_mount = np.array([*position, SHAKING_SIGMA_M, *roll_pitch_yaw])
    covariance[range(6, 12), range(6, 12)] = of_mount**2
    covariance[range(12, 15), range(12, 15)] = clock**2
    none = np.zeros((0, 2))
    nominal = DriveState(
        correctable(lens),
        robot.T_base_camera,
        np.array([robot.camera_time_offset_s, 0.0, 0.0]),
        np.zeros((0, 4, 4)),
        none,
        none,
        np.zeros(0),
    )
    return Prior(nominal, np.linalg.inv(covariance))


def mount_angles(T_base_camera: np.ndarray) -> np.ndarray:
    """(3,) roll, pitch, yaw of a mount, rad."""
    return Rotation.from_matrix(T_base_camera[:3, :3]).as_euler("ZYX")[::-1]


def in_calibration_order(found: FoundDrive) -> Tuple[np.ndarray, np.ndarray]:
    """Values (14,) and covariance (14, 14): those of a lens, then those of `calibration_problem.Solution`."""
    state = found.state
    angles = mount_angles(state.T_base_camera)
    pick = np.zeros((14, OF_DRIVE))
    pick[range(6), range(6)] = 1.0
    for axis, step in enumerate(1e-6 * np.eye(3)):
        turned = state.T_base_camera.copy()
        turned[:3, :3] = Rotation.from_rotvec(step).as_matrix() @ turned[:3, :3]
        pick[6:9, MOUNT.start + 3 + axis] = (mount_angles(turned) - angles) / 1e-6
    pick[[9, 10], [MOUNT.start, MOUNT.start + 1]] = 1.0
    pick[range(11, 14), range(WHEELS.start, WHEELS.stop)] = 1.0
    values = np.concatenate([vector_of(state.lens), angles, state.T_base_camera[:2, 3], state.wheels])
    return values, pick @ found.covariance @ pick.T
