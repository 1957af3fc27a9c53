# SPDX-License-Identifier: BSD-3-Clause
"""From scans to poses: tracking, loops, graph, then poses and map together until nothing moves."""

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.graph import Relation, solve_graph
from ceiling_dso_ros.lidar.mapping.joint_solution import JointSolution, solve_jointly
from ceiling_dso_ros.lidar.mapping.landmarks import KeyframePoints, LandmarkMap
from ceiling_dso_ros.lidar.mapping.loops import LoopFinder
from ceiling_dso_ros.lidar.mapping.map_keyframes import MapKeyframes
from ceiling_dso_ros.lidar.matching.tracking import ScanTracker, Track, submap_radius_m
from ceiling_dso_ros.lidar.scans.poses import Path, between, carried, logmap
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints, steady
from ceiling_dso_ros.lidar.scans.sweep_motion import sweep_motions
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions

MOST_ROUNDS = 4
LOOP_ROUNDS = 3
WEAK = 5.0  # times the standard deviations of relations that only hold what the points leave open
PRIOR_SIGMAS = np.array([0.05, 0.05, 0.03])  # of a scan seen from its keyframe, without wheels
WHEEL_FACTOR = 3.0  # times those of the wheels: where the points tell more, the wheels shall not count


@dataclass(frozen=True)
class Localisation:
    """Poses (N, 3) of scans in a map, and what was known of each.

    Attributes:
        poses: of the base at the stamps of the scans.
        informations: (N, 3, 3) of the points.
        priors: (N, 3, 3) of what was known without them.
        counts: (N,) points that fit.
    """

    poses: np.ndarray
    informations: np.ndarray
    priors: np.ndarray
    counts: np.ndarray


@dataclass(frozen=True)
class Solution:
    """What is known of a recording.

    Attributes:
        track: the first pass.
        keyframes: (K,) scans that the map is made of, in the order of time.
        nearest: (N,) number of the keyframe in whose surroundings each scan was localised.
        joint: their poses with the map.
        localisation: of all scans in it.
        loops: those that were found; is_right says for each whether it fits to the others.
        is_right: (L,) bool.
        relations: what holds the keyframes beside their points.
        rounds: how often the map was made again from all poses.
    """

    track: Track
    keyframes: np.ndarray
    nearest: np.ndarray
    joint: JointSolution
    localisation: Localisation
    loops: Sequence[Relation]
    is_right: np.ndarray
    relations: Sequence[Relation]
    rounds: int


def solve(scans: LaserScans, wheels: Optional[WheelMotions], config: LidarConfig, backwards: bool = False) -> Solution:
    """Solve a recording; backwards begins with its last scan."""
    points = ScanPoints(scans)
    track = ScanTracker(scans, wheels, config, backwards).run()
    motions = steady(track.twists)
    order = [keyframe.scan for keyframe in track.keyframes]
    poses = track.poses[order]
    chain = [
        Relation(number, number + 1, keyframe.moved, keyframe.covariance)
        for number, keyframe in enumerate(track.keyframes[1:])
    ]
    driven = [] if wheels is None else _wheel_relations(scans, wheels, order)
    steps_m = np.hypot(*np.diff(poses[:, :2], axis=0).T) if len(poses) > 1 else np.zeros(0)
    finder = LoopFinder(
        lambda number: points.of(order[number], motions[order[number]]),
        lambda number: points.dense(order[number], motions[order[number]]),
        np.append(0.0, np.cumsum(steps_m)),
        submap_radius_m(scans),
        config,
    )
    loops: List[Relation] = []
    is_right = np.ones(0, bool)
    for number in range(LOOP_ROUNDS):
        found = finder.find(poses)
        loops += found
        if number and not found:
            break
        solution = solve_graph(poses, chain, [*driven, *loops])
        poses, is_right = solution.poses, solution.is_right[len(driven) :]
    keyframes = MapKeyframes.choose(np.array(order), poses, config.keyframe_m, config.keyframe_rad)
    right = [loop for loop, right in zip(loops, is_right) if right]
    relations = [*(_weakened(each) for each in keyframes.relations(chain, right)), *keyframes.relations(driven, [])]
    if backwards:
        keyframes = keyframes.backwards()
        last = len(keyframes.chosen) - 1
        relations = [Relation(last - r.first, last - r.second, r.moved, r.covariance) for r in relations]
    most_rounds = 1 if backwards else MOST_ROUNDS  # the other way is but a check
    refined = refine(scans, wheels, config, track, keyframes, relations, most_rounds)
    nearest = keyframes.hosts[nearest_keyframe(scans, keyframes.scans)]
    return Solution(track, keyframes.map_scans, nearest, *refined[:2], loops, is_right, relations, refined[2])


def refine(
    scans: LaserScans,
    wheels: Optional[WheelMotions],
    config: LidarConfig,
    track: Track,
    keyframes: MapKeyframes,
    relations: Sequence[Relation],
    most_rounds: int = MOST_ROUNDS,
) -> Tuple[JointSolution, Localisation, int]:
    """Solve poses and map together, and localise all scans in the map, until no scan moves any more.

    Each time, scans are freed of the motion that the poses of the time before tell.
    """
    points = ScanPoints(scans)
    shape = Path(scans.stamps_ns, track.poses)
    motions = steady(track.twists)
    before: Optional[np.ndarray] = None
    poses = keyframes.map_poses
    rounds = 0
    while True:
        rounds += 1
        map_scans = keyframes.map_scans.tolist()
        parts = KeyframePoints.of([points.of(scan, motions[scan]) for scan in map_scans], points.laser)
        joint = solve_jointly(parts, poses, relations, config)
        poses = joint.poses
        anchors = Path(scans.stamps_ns[keyframes.scans], keyframes.carried(poses))
        guess = carried(anchors, shape, scans.stamps_ns)
        priors = _priors(scans, wheels, keyframes.scans, guess)
        located = localise_scans(points, motions, joint.landmark_map, guess, priors, np.arange(len(scans)))
        if rounds == most_rounds or (before is not None and _is_still(before, located.poses, config)):
            return joint, located, rounds
        before = located.poses
        motions = sweep_motions(scans, points, wheels, located.poses, track.twists)


def localise_scans(
    points: ScanPoints,
    motions: np.ndarray,
    landmark_map: LandmarkMap,
    guess: np.ndarray,
    priors: np.ndarray,
    which: np.ndarray,
) -> Localisation:
    """Localise scans in a map, each by itself.

    Args:
        points: of all scans.
        motions: (N, 2, 3) during the scans.
        landmark_map: the map.
        guess: (N, 3) first guesses.
        priors: (N, 3, 3) their information.
        which: (M,) scans that are wanted.
    """
    poses, informations, counts = np.zeros((len(which), 3)), np.zeros((len(which), 3, 3)), np.zeros(len(which), int)
    for row, scan in enumerate(which.tolist()):
        found = landmark_map.localise(points.of(scan, motions[scan]), guess[scan], priors[scan])
        poses[row], informations[row], counts[row] = found
    return Localisation(poses, informations, priors[which], counts)


def nearest_keyframe(scans: LaserScans, keyframes: np.ndarray) -> np.ndarray:
    """(N,) number of the keyframe that is nearest in time to each scan."""
    stamps_ns = scans.stamps_ns[keyframes]
    after = np.clip(np.searchsorted(stamps_ns, scans.stamps_ns), 1, max(len(keyframes) - 1, 1))
    after = np.minimum(after, len(keyframes) - 1)
    before = np.maximum(after - 1, 0)
    is_before = scans.stamps_ns - stamps_ns[before] <= stamps_ns[after] - scans.stamps_ns
    return np.where(is_before, before, after)


def _is_still(before: np.ndarray, after: np.ndarray, config: LidarConfig) -> bool:
    moved = logmap(between(before, after))
    return bool(np.abs(moved[:, :2]).max() < config.converged_m and np.abs(moved[:, 2]).max() < config.converged_rad)


def _priors(scans: LaserScans, wheels: Optional[WheelMotions], keyframes: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """(N, 3, 3) information of the guesses, which are carried from the nearest keyframes."""
    sigmas = np.tile(PRIOR_SIGMAS, (len(scans), 1))
    if wheels is not None:
        from_ns = scans.stamps_ns[keyframes][nearest_keyframe(scans, keyframes)]
        driven = WHEEL_FACTOR * wheels.sigmas(from_ns, scans.stamps_ns)
        sigmas = np.where(wheels.covers(from_ns, scans.stamps_ns)[:, None], driven, sigmas)
    turned = np.tile(np.eye(3), (len(scans), 1, 1))
    yaw = np.ascontiguousarray(guess[:, 2])
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(yaw)
    turned[:, 1, 0] = np.sin(yaw)
    turned[:, 0, 1] = -turned[:, 1, 0]
    return np.einsum("nij,nj,nkj->nik", turned, sigmas**-2.0, turned)


def _wheel_relations(scans: LaserScans, wheels: WheelMotions, order: Sequence[int]) -> List[Relation]:
    stamps_ns = scans.stamps_ns[list(order)]
    moved, sigmas = wheels.between(stamps_ns[:-1], stamps_ns[1:]), wheels.sigmas(stamps_ns[:-1], stamps_ns[1:])
    covered = wheels.covers(stamps_ns[:-1], stamps_ns[1:])
    return [
        Relation(number, number + 1, moved[number], np.diag(sigmas[number] ** 2))
        for number in np.flatnonzero(covered).tolist()
    ]


def _weakened(relation: Relation) -> Relation:
    return Relation(relation.first, relation.second, relation.moved, WEAK**2 * relation.covariance)
