# SPDX-License-Identifier: BSD-3-Clause
"""From scan to scan: each scan is aligned with a submap of the keyframes before it."""

from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.matching.likelihood_field import LikelihoodField, Match
from ceiling_dso_ros.lidar.scans.poses import transformed
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints, steady
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions

ANY_SPEED_M_S, ANY_TURN_RAD_S = 1.0, 0.8  # of a robot of which nothing else is known
STALE_S = 1.0  # a velocity that is older tells nothing of the next motion
LARGEST_STEP_M, LARGEST_STEP_RAD = 1.5, 1.2  # of a search without wheels
SURE_SIGMA_M, SURE_SIGMA_RAD = 0.05, 0.05  # of a prediction: from there, Gauss-Newton needs no search
POOR_FIT = 0.75  # of the usual share of points that fit: what is worse is searched
SEARCH_SCORE = 0.5
NOISE_FACTOR = 2.0  # of the standard deviation that the points tell: those of a submap are not independent
LEAST_SIGMAS = np.array([0.003, 0.003, 0.001])
LEAST_PREDICTED = np.array([0.01, 0.01, 0.005])  # of a prediction: wheels slip, and mounts are measured by hand
RADIUS_M = (10.0, 40.0)  # of a submap
LOST_S = 1.0  # without a match and without wheels: then a new map is begun
LARGEST_MOVING_SHARE = 0.6  # of the points: if more are where nothing stood, it is the pose that is wrong


@dataclass(frozen=True)
class Keyframe:
    """A scan that the map is made of.

    Attributes:
        scan: its index.
        moved: (3,) pose seen from the keyframe before.
        covariance: (3, 3) of that, seen from this keyframe.
    """

    scan: int
    moved: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class Track:
    """What is known after one pass over all scans.

    Attributes:
        poses: (N, 3) of the base at the stamps, in the frame of the first one.
        fits: (N,) share of the points of each scan that fit the submap.
        is_matched: (N,) bool, False where the pose is but a prediction.
        keyframes: in the order in which they were made.
        twists: (N, 3) m/s, m/s, rad/s during each scan.
    """

    poses: np.ndarray
    fits: np.ndarray
    is_matched: np.ndarray
    keyframes: List[Keyframe]
    twists: np.ndarray


class _Submap:
    """The field around a keyframe."""

    def __init__(self, origin: np.ndarray, radius_m: float, config: LidarConfig) -> None:
        self.origin = origin
        self.field = LikelihoodField(radius_m, config)
        self.keyframes = 0

    def add(self, pose: np.ndarray, points: np.ndarray, dense: np.ndarray, laser: np.ndarray) -> None:
        """Add a keyframe with a pose in the frame of the track; what moves is left out.

        Args:
            pose: of the robot.
            points: (n, 2) of its scan, seen from the robot.
            dense: the same with more points.
            laser: (2,) its place, seen from the robot.
        """
        local = planar.between(self.origin, pose)
        placed = transformed(dense, local)
        self.field.add(placed[~self.field.is_moving(placed)])
        self.field.mark_free(transformed(points, local), transformed(laser[None], local)[0])
        self.keyframes += 1

    def standing(self, points: np.ndarray, local: np.ndarray) -> np.ndarray:
        """The points of a robot with a pose in the frame of the field, without those that move."""
        moving = self.field.is_moving(transformed(points, local))
        return points if moving.mean() > LARGEST_MOVING_SHARE else points[~moving]


class ScanTracker:
    """One pass over the scans, forwards or backwards in time."""

    def __init__(
        self, scans: LaserScans, wheels: Optional[WheelMotions], config: LidarConfig, backwards: bool = False
    ) -> None:
        """Begin; nothing is matched yet."""
        self._config, self._scans = config, scans
        self._points = ScanPoints(scans)
        count = len(scans)
        self._order = np.arange(count)[::-1] if backwards else np.arange(count)
        stamps_ns, ends_ns = scans.stamps_ns, self._points.end_stamps_ns
        from_ns, to_ns = stamps_ns[self._order[:-1]], stamps_ns[self._order[1:]]
        self._steps_s = seconds(to_ns - from_ns)
        self._moved, self._sigmas = np.zeros((count - 1, 3)), np.zeros((count - 1, 3))
        self._is_driven = np.zeros(count - 1, bool)
        self._twists, self._has_twist = np.zeros((count, 3)), np.zeros(count, bool)
        if wheels is not None:
            self._moved, self._sigmas = wheels.between(from_ns, to_ns), wheels.sigmas(from_ns, to_ns)
            self._is_driven = wheels.covers(from_ns, to_ns)
            self._twists = self._points.twists_over_sweeps(wheels.between(stamps_ns, ends_ns))
            self._has_twist = wheels.covers(stamps_ns, ends_ns)
        self._radius_m = submap_radius_m(scans)
        self._submaps: List[_Submap] = []
        self._usual_fit = 1.0
        self._pose, self._velocity, self._last_keyframe = np.zeros(3), np.zeros(3), np.zeros(3)
        self._has_velocity = False
        self._lost_s, self._lost_sigmas = 0.0, np.zeros(3)  # how long nothing has matched, and what that costs
        self._poses, self._fits, self._is_matched = np.zeros((count, 3)), np.zeros(count), np.zeros(count, bool)
        self._keyframes: List[Keyframe] = []

    def run(self) -> Track:
        """Match all scans."""
        for step, scan in enumerate(self._order.tolist()):
            if not self._has_twist[scan]:
                self._twists[scan] = self._velocity
            points = self._points.of(scan, steady(self._twists[scan]))
            if step == 0:
                self._is_matched[scan], self._fits[scan] = len(points) > 0, 1.0
                self._add_keyframe(Keyframe(scan, np.zeros(3), np.zeros((3, 3))), points)
            else:
                self._take(step - 1, scan, points)
        return Track(self._poses, self._fits, self._is_matched, self._keyframes, self._twists)

    def _take(self, step: int, scan: int, points: np.ndarray) -> None:
        predicted, sigmas = self._predict(step)
        match = self._match(points, predicted, sigmas)
        before = self._pose
        if match is None:
            self._pose = predicted
            self._lost_s += abs(float(self._steps_s[step]))
            self._lost_sigmas = np.hypot(self._lost_sigmas, sigmas)
        else:
            self._pose = planar.compose(self._submaps[0].origin, match.pose)
            self._fits[scan], self._is_matched[scan] = match.fit, True
            self._lost_s, self._lost_sigmas = 0.0, np.zeros(3)
        self._poses[scan] = self._pose
        self._update_velocity(step, before)
        moved = planar.between(self._last_keyframe, self._pose)
        is_driven = self._is_driven[step]
        begins_again = self._lost_s >= LOST_S and not is_driven and len(points) > 0
        if begins_again:  # somewhere else, with a map of its own
            self._submaps.clear()
            self._lost_s, self._has_velocity = 0.0, False
        if begins_again or (self._is_far(moved) and (match is not None or is_driven)):
            covariance = (
                np.diag(np.maximum(self._lost_sigmas, 10.0 * LEAST_SIGMAS) ** 2)
                if match is None
                else self._covariance(match, sigmas)
            )
            self._add_keyframe(Keyframe(scan, moved, covariance), points)

    def _predict(self, step: int) -> Tuple[np.ndarray, np.ndarray]:
        """The next pose, and standard deviations of its x, y, yaw."""
        if self._is_driven[step]:
            return planar.compose(self._pose, self._moved[step]), 2.0 * self._sigmas[step]
        step_s = float(self._steps_s[step])
        ahead_m = 0.005 + 0.5 * self._config.acceleration_m_s2 * step_s**2
        turn_rad = 0.005 + 0.5 * self._config.acceleration_rad_s2 * step_s**2
        if not self._has_velocity or abs(step_s) >= STALE_S:
            ahead_m, turn_rad = ahead_m + ANY_SPEED_M_S * abs(step_s), turn_rad + ANY_TURN_RAD_S * abs(step_s)
            predicted = self._pose
        else:
            predicted = planar.compose(self._pose, planar.expmap(self._velocity * step_s))
        ahead_m, turn_rad = min(ahead_m, LARGEST_STEP_M), min(turn_rad, LARGEST_STEP_RAD)
        return predicted, np.array([ahead_m, ahead_m, turn_rad])

    def _update_velocity(self, step: int, before: np.ndarray) -> None:
        step_s = float(self._steps_s[step])
        self._has_velocity = abs(step_s) < STALE_S
        self._velocity = (
            planar.logmap(planar.between(before, self._pose)) / step_s if self._has_velocity else np.zeros(3)
        )

    def _match(self, points: np.ndarray, predicted: np.ndarray, sigmas: np.ndarray) -> Optional[Match]:
        """The pose in the older submap; None where too few points fit anywhere."""
        if not len(points):
            return None
        submap = self._submaps[0]
        local = planar.between(submap.origin, predicted)
        known = np.diag(1.0 / np.maximum(sigmas, LEAST_PREDICTED) ** 2)
        is_sure = sigmas[0] < SURE_SIGMA_M and sigmas[2] < SURE_SIGMA_RAD
        seen = submap.standing(points, local) if is_sure else points  # elsewhere, all of it would seem to move
        match = submap.field.align(seen, local, local, known)
        if not is_sure or match.fit < POOR_FIT * self._usual_fit:
            reach_m = float(np.clip(3.0 * sigmas[0], 0.3, LARGEST_STEP_M))
            reach_rad = float(np.clip(3.0 * sigmas[2], 0.15, LARGEST_STEP_RAD))
            place = submap.field.search(points, local, reach_m, reach_rad, SEARCH_SCORE)
            if place is not None:
                other = submap.field.align(submap.standing(points, place.pose), place.pose, local, known)
                match = other if other.fit > match.fit or not is_sure else match
        if match.fit < self._config.least_fit:
            return None
        self._usual_fit += 0.05 * (match.fit - self._usual_fit)
        return match

    def _is_far(self, moved: np.ndarray) -> bool:
        config = self._config
        return bool(np.hypot(moved[0], moved[1]) > config.keyframe_m or abs(moved[2]) > config.keyframe_rad)

    def _covariance(self, match: Match, sigmas: np.ndarray) -> np.ndarray:
        """Of a matched pose, seen from itself; the prediction limits it where the points do not."""
        turned = np.eye(3)
        turned[:2, :2] = planar.rotation(match.pose[2])
        information = turned.T @ match.information @ turned / NOISE_FACTOR**2
        information += np.diag(1.0 / np.maximum(10.0 * sigmas, 0.2) ** 2)
        return np.linalg.inv(information) + np.diag(LEAST_SIGMAS**2)

    def _add_keyframe(self, keyframe: Keyframe, points: np.ndarray) -> None:
        """Add a keyframe to both submaps; begin a new one when the newer one has half of its keyframes."""
        self._keyframes.append(keyframe)
        self._last_keyframe = self._pose
        half = self._config.submap_keyframes // 2
        if not self._submaps or self._submaps[-1].keyframes == half:
            self._submaps.append(_Submap(self._pose, self._radius_m, self._config))
        if len(self._submaps) > 2:
            del self._submaps[0]
        dense = self._points.dense(keyframe.scan, steady(self._twists[keyframe.scan]))
        for submap in self._submaps:
            submap.add(self._pose, points, dense, self._points.laser)


def submap_radius_m(scans: LaserScans) -> float:
    """How far the scanner sees, but for a few rays."""
    return float(np.clip(1.1 * np.nanpercentile(scans.ranges_m, 98.0), *RADIUS_M))
