# SPDX-License-Identifier: BSD-3-Clause
"""A robot at the level of trajectories: wheels that tick and slip, a visual odometry with noise, drift and losses."""

from dataclasses import dataclass, field
from typing import List, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import RobotModel

RATE_HZ = 600  # of the simulated motion: a multiple of the wheels' 50 Hz and the camera's 30 Hz
WHEEL_STEP, FRAME_STEP = RATE_HZ // 50, RATE_HZ // 30
KEYFRAME_FRAMES = 5
VO_WINDOW = 7


def rotation_vector(w):
    angle = np.linalg.norm(w)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = np.asarray(w) / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def mount(roll_deg=1.5, pitch_deg=-1.0, yaw_deg=-88.0, xyz=(0.18, 0.04, 0.62)):
    """T_base_camera of a camera that looks up."""
    T = np.eye(4)
    r, p, y = np.radians([roll_deg, pitch_deg, yaw_deg])
    T[:3, :3] = rotation_vector([0, 0, y]) @ rotation_vector([0, p, 0]) @ rotation_vector([r, 0, 0])
    T[:3, 3] = xyz
    return T


@dataclass
class Truth:
    """What the robot really is, relative to what is believed."""

    ratio: float = 0.0  # logarithms
    base: float = 0.0
    radius: float = 0.0
    wheel_noise: float = 0.002  # m per sqrt(m)
    shift_sigma: float = 1.5e-4  # units, keyframe to keyframe: 0.7 mm below a ceiling of 4.5 m
    turn_sigma: float = 2e-4  # rad: 0.011 degrees
    scale_walk: float = 4e-4
    vibration: float = 1e-3  # rad of roll and pitch
    unit_m: float = 4.5
    camera_delay_s: float = 0.0  # a motion is seen in the image whose stamp is this much later
    slips: Tuple[Tuple[float, float], ...] = ()  # left wheel turns further in [start, end]
    slip_factor: float = 2.0  # by this factor
    both_slip: bool = False  # the right wheel as well
    losses: Tuple[Tuple[float, float], ...] = ()
    scale_jumps: Tuple[Tuple[float, float], ...] = ()  # (time, factor on the metres per unit)
    T_base_camera: np.ndarray = field(default_factory=mount)


@dataclass
class Drive:
    """Everything recorded of one drive, and the truth."""

    robot: RobotModel
    stamps: np.ndarray  # int64 nanoseconds, at RATE_HZ
    poses: np.ndarray  # (n, 3) true base poses, from the origin
    ticks: List[Tuple[int, int, int]]
    statuses: List[OdometryStatus]
    metres_per_unit: dict  # keyframe id -> true scale
    cameras: dict  # keyframe id -> true (4, 4) T_world_camera

    def pose_at(self, stamp_ns):
        index = np.clip(seconds(stamp_ns - self.stamps[0]) * RATE_HZ, 0, len(self.stamps) - 1)
        low = int(min(index, len(self.stamps) - 2))
        step = planar.logmap(planar.between(self.poses[low], self.poses[low + 1]))
        return planar.compose(self.poses[low], planar.expmap((index - low) * step))

    @property
    def path_m(self):
        return np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum()

    def events(self):
        """Samples and statuses in the order of their stamps."""
        wheel = [(stamp, 0, sample) for stamp, *sample in self.ticks]
        camera = [(status.stamp_ns, 1, status) for status in self.statuses]
        return sorted(wheel + camera, key=lambda event: event[:2])


def plan(name, duration_s):
    """Wanted (v, w) over time at RATE_HZ."""
    n = int(duration_s * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    if name == "straight":
        v, w = np.full(n, 0.8), np.zeros(n)
    elif name == "loops":
        v = 0.9 + 0.2 * np.sin(0.5 * t)
        w = 0.65 * np.sign(np.sin(2 * np.pi * t / 38.0)) + 0.1 * np.sin(0.9 * t)
    elif name == "square":
        lap = np.mod(t, 18.0)
        v, w = np.where(lap < 14.0, 1.0, 0.5), np.where((lap >= 14.0) & (lap < 17.6), 0.5 * np.pi / 3.6, 0.0)
    elif name == "spin":
        v, w = np.zeros(n), 0.6 * np.sign(np.sin(2 * np.pi * t / 20.0))
    elif name == "stop_and_go":
        v, w = np.where(np.mod(t, 12.0) < 8.0, 0.8, 0.0), np.where(np.mod(t, 12.0) < 8.0, 0.3 * np.sin(0.4 * t), 0.0)
    else:
        raise ValueError(name)
    moving = t > 1.0
    return v * moving, w * moving


def limited(wanted, rate):
    """Follows the wanted values with a bounded change per second."""
    result, now = np.empty_like(wanted), 0.0
    for index, value in enumerate(wanted):
        now += np.clip(value - now, -rate / RATE_HZ, rate / RATE_HZ)
        result[index] = now
    return result


def true_motion(name, duration_s):
    v, w = plan(name, duration_s)
    v, w = limited(v, 0.8), limited(w, 1.5)
    yaw = np.concatenate([[0.0], np.cumsum(w) / RATE_HZ])
    middle = yaw[:-1] + 0.5 * w / RATE_HZ
    xy = np.cumsum(np.stack([v * np.cos(middle), v * np.sin(middle)], axis=1) / RATE_HZ, axis=0)
    poses = np.column_stack([np.vstack([[0.0, 0.0], xy]), yaw])
    return poses, v, w


def encoder_ticks(stamps, v, w, robot, truth, rng):
    base = robot.wheel_base_m * np.exp(truth.base)
    radii = np.array(robot.wheel_radius_m) * np.exp(truth.radius + truth.ratio * np.array([-0.5, 0.5]))
    ground = np.stack([v - 0.5 * base * w, v + 0.5 * base * w], axis=1) / RATE_HZ
    turned = np.vstack([[0.0, 0.0], np.cumsum(ground, axis=0)])[::WHEEL_STEP]
    times = stamps[::WHEEL_STEP]
    steps = np.diff(turned, axis=0)
    for start, end in truth.slips:
        slipping = (times[1:] > stamps[0] + nanoseconds(start)) & (times[1:] <= stamps[0] + nanoseconds(end))
        steps[slipping, : 1 + truth.both_slip] *= truth.slip_factor
    steps += truth.wheel_noise * np.sqrt(np.abs(steps)) * rng.normal(size=steps.shape)
    angle = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]) / radii
    counts = np.floor(angle * robot.ticks_per_turn / (2 * np.pi) + rng.uniform(size=2)).astype(np.int64)
    return [(int(t), int(left), int(right)) for t, (left, right) in zip(times, counts)]


class VisualSimulator:
    """Tracks the true camera with noise; keyframes every few frames while moving."""

    def __init__(self, truth, rng):
        self.truth, self.rng = truth, rng
        self.statuses, self.metres_per_unit, self.cameras = [], {}, {}
        self.segment, self.next_id = -1, 0
        self.window, self.pending = [], None
        self.log_unit = np.log(truth.unit_m)

    def noisy(self, T, factor=1.0):
        """With the noise of one keyframe step; T in VO units."""
        noise = np.eye(4)
        noise[:3, 3] = factor * self.truth.shift_sigma * self.rng.normal(size=3)
        noise[:3, :3] = rotation_vector(factor * self.truth.turn_sigma * self.rng.normal(size=3))
        return T @ noise

    def start_segment(self, stamp, T_camera):
        self.segment += 1
        self.log_unit = np.log(self.truth.unit_m) + 0.15 * self.rng.normal()
        self.window = []
        self.keep(stamp, T_camera, np.eye(4))

    def keep(self, stamp, T_true, T_vo):
        self.window.append((self.next_id, stamp, T_true, T_vo, self.truth.unit_m / np.exp(self.log_unit)))
        self.metres_per_unit[self.next_id] = np.exp(self.log_unit)
        self.cameras[self.next_id] = T_true
        self.next_id += 1

    def estimates(self):
        """The window as refined now: the newest keyframes still err a little more than in the end."""
        leaving = len(self.window) > VO_WINDOW
        result = []
        for age, (key, stamp, _, T_vo, depth) in enumerate(reversed(self.window)):
            T = T_vo if age > 3 else self.noisy(T_vo, 0.4 / (1 + age))
            leaves = leaving and age == VO_WINDOW
            result.append(KeyframeEstimate(key, stamp, self.segment, T, (0.0, 0.0), leaves, depth))
        if leaving:
            self.window.pop(0)
        return tuple(reversed(result))

    def relative(self, T_true):
        """True motion since the newest keyframe in VO units."""
        T = np.linalg.inv(self.window[-1][2]) @ T_true
        T[:3, 3] /= np.exp(self.log_unit)
        return T

    def frame(self, stamp, T_true, lost, frames_since, jump=1.0):
        self.log_unit += np.log(jump)
        if lost:
            self.window, self.pending = [], None
            self.statuses.append(OdometryStatus(stamp, TrackingState.LOST, max(self.segment, 0), message="covered"))
            return False
        if not self.window:
            self.start_segment(stamp, T_true)
            self.pending = stamp
        T_step = self.relative(T_true)
        far = np.linalg.norm(T_step[:3, 3]) > 0.01 or abs(T_step[1, 0]) > 0.04
        if self.pending is not None and not far:
            state = TrackingState.INITIALIZING if self.segment == 0 else TrackingState.RECOVERING
            self.statuses.append(OdometryStatus(stamp, state, self.segment))
            return False
        is_keyframe = far and (self.pending is not None or frames_since >= KEYFRAME_FRAMES)
        self.pending = None
        if is_keyframe:
            way = max(np.linalg.norm(T_step[:3, 3]), 0.01)
            self.log_unit += self.truth.scale_walk * np.sqrt(way) * self.rng.normal()
            self.keep(stamp, T_true, self.window[-1][3] @ self.noisy(self.relative(T_true)))
            keyframes = self.estimates()
            key, T_relative = keyframes[-1].keyframe_id, np.eye(4)
        else:
            keyframes = ()
            key, T_relative = self.window[-1][0], self.noisy(T_step)
        T_world = (keyframes[-1].T_world_camera if is_keyframe else self.window[-1][3]) @ T_relative
        self.statuses.append(
            OdometryStatus(
                stamp,
                TrackingState.TRACKING,
                self.segment,
                T_world,
                np.eye(6) * 1e-8,
                is_keyframe,
                key,
                T_relative,
                keyframes,
            )
        )
        return is_keyframe


def record_camera(stamps, poses, truth, rng):
    camera = VisualSimulator(truth, rng)
    jumps = list(truth.scale_jumps)
    since = 0
    for index in range(0, len(poses) - 1, FRAME_STEP):
        t = index / RATE_HZ
        wobble = np.eye(4)
        wobble[:3, :3] = rotation_vector([*(truth.vibration * rng.normal(size=2)), 0.0])
        T = planar.lift(poses[index]) @ wobble @ truth.T_base_camera
        lost = any(start <= t < end for start, end in truth.losses)
        jump = jumps.pop(0)[1] if jumps and t >= jumps[0][0] else 1.0
        since = (
            1
            if camera.frame(int(stamps[index]) + nanoseconds(truth.camera_delay_s), T, lost, since, jump)
            else since + 1
        )
    return camera.statuses, camera.metres_per_unit, camera.cameras


def simulate_drive(name="loops", duration_s=60.0, seed=0, truth=None, start_ns=1_000 * 10**9):
    """Drive a sequence and record it."""
    truth = truth or Truth()
    rng = np.random.default_rng(seed)
    robot = RobotModel(truth.T_base_camera, 0.485, (0.098, 0.098), 4096.0)
    poses, v, w = true_motion(name, duration_s)
    stamps = start_ns + np.rint(np.arange(len(poses)) * (1e9 / RATE_HZ)).astype(np.int64)
    ticks = encoder_ticks(stamps, v, w, robot, truth, rng)
    return Drive(robot, stamps, poses, ticks, *record_camera(stamps, poses, truth, rng))
