# SPDX-License-Identifier: BSD-3-Clause
"""A reference trajectory: base_link in `map` over time, and how sure it is."""

from dataclasses import asdict, dataclass
from typing import Any, Callable, Dict, List, Optional

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.io.trajectory import Trajectory
from ceiling_dso_ros.io.warning_log import ignore_warning
from ceiling_dso_ros.lidar import uncertainty
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.solution import Solution, solve
from ceiling_dso_ros.lidar.mount_check import MountError, check_mount
from ceiling_dso_ros.lidar.scans.poses import Path, carried, matrices
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions
from ceiling_dso_ros.lidar.self_checks import Difference, backwards_against_forwards, odd_against_even

FEW_RAYS = 0.6  # share of valid rays, below which the scanner is dirty or sees glass
UNMATCHED = 0.02  # share of scans without a pose of their own that is said
LARGEST_TILT = 0.05  # of the scan's plane, as the sine of an angle
DISAGREEING = 2.0  # times the computed standard deviation: then the differences found by itself count


@dataclass(frozen=True)
class Reference:
    """A reference trajectory.

    Attributes:
        path: of base_link in the map, at the stamps of the scans; the map begins at the first pose, but for some mm.
        covariances: (N, 3, 3) of x, y, yaw in the map, after an alignment of the whole.
        scans: what it was made of.
        wheels: how the robot moved between scans; None where no wheels told.
        solution: how it was made.
        odd_even, backwards: what it says of itself; None where that was not asked for, or cannot be said.
        mount: what the motion says of the laser's mount; None where it says nothing.
        warnings: what is doubtful, one line each.
    """

    path: Path
    covariances: np.ndarray
    scans: LaserScans
    wheels: Optional[WheelMotions]
    solution: Solution
    odd_even: Optional[Difference]
    backwards: Optional[Difference]
    mount: Optional[MountError]
    warnings: List[str]

    def at(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Poses (M, 3) at any stamps: between scans the robot moves as its wheels say, or on arcs."""
        wheels = self.wheels
        shape = self.path
        if wheels is not None and wheels.covers(self.path.stamps_ns[:1], self.path.stamps_ns[-1:])[0]:
            shape = wheels.path
        return carried(self.path, shape, stamps_ns)

    def trajectory(
        self, stamps_ns: Optional[np.ndarray] = None, T_base_body: Optional[np.ndarray] = None
    ) -> Trajectory:
        """Poses of base_link, or of what is mounted on it, at the stamps of the scans or at others."""
        wanted = self.path.stamps_ns if stamps_ns is None else stamps_ns
        T = matrices(self.at(wanted) if stamps_ns is not None else self.path.poses)
        return Trajectory.from_matrices(wanted, T if T_base_body is None else T @ T_base_body)

    @property
    def position_sigmas_m(self) -> np.ndarray:
        """(N,) root mean squared distances from the truth."""
        return uncertainty.position_sigmas(self.covariances)

    @property
    def yaw_sigmas_rad(self) -> np.ndarray:
        """(N,)."""
        return uncertainty.yaw_sigmas(self.covariances)

    @property
    def is_corridor(self) -> np.ndarray:
        """(N,) bool: scans that hardly tell where the robot is along."""
        return uncertainty.is_corridor(self.solution.localisation.informations)

    def numbers(self) -> Dict[str, Any]:
        """How sure it is, as types that JSON supports."""
        solution, position_m, yaw_rad = self.solution, self.position_sigmas_m, self.yaw_sigmas_rad
        small, large = uncertainty.translation_eigenvalues(solution.localisation.informations).T
        return {
            "scans": len(self.scans),
            "duration_s": float(seconds(self.path.stamps_ns[-1] - self.path.stamps_ns[0])),
            "path_m": float(np.hypot(*np.diff(self.path.poses[:, :2], axis=0).T).sum()),
            "valid_rays": self.scans.valid_share,
            "scans_without_match": int(np.count_nonzero(~self.solution.track.is_matched)),
            "keyframes": len(solution.keyframes),
            "landmarks": solution.joint.landmark_map.count,
            "range_sigma_m": solution.joint.landmark_map.sigma_m,
            "loops": {"found": len(solution.loops), "right": int(np.count_nonzero(solution.is_right))},
            "sigma": {
                "position_rms_m": float(np.sqrt(np.mean(position_m**2))),
                "position_max_m": float(position_m.max()),
                "yaw_rms_deg": float(np.degrees(np.sqrt(np.mean(yaw_rad**2)))),
                "yaw_max_deg": float(np.degrees(yaw_rad.max())),
            },
            "corridor": {
                "scans": int(np.count_nonzero(self.is_corridor)),
                "smallest_eigenvalue_ratio": float(np.min(small / np.maximum(large, 1e-12))),
            },
            "odd_against_even": None if self.odd_even is None else asdict(self.odd_even),
            "backwards_against_forwards": None if self.backwards is None else asdict(self.backwards),
            "mount": None if self.mount is None else asdict(self.mount),
            "warnings": self.warnings,
        }


def estimate_reference(
    scans: LaserScans,
    wheels: Optional[WheelMotions],
    config: LidarConfig = LidarConfig(),
    check_itself: bool = True,
    warn: Callable[[str], None] = ignore_warning,
) -> Reference:
    """Estimate where the robot was at each scan.

    Args:
        scans: of its 2D LiDAR.
        wheels: its wheels; None where there are none.
        config: settings.
        check_itself: also compare halves of the scans, and the way back.
        warn: is told what is doubtful, one line each.

    Raises:
        InputError: the scans cannot be used.
        ConfigError: a setting is out of range.
    """
    config.check()
    warnings: List[str] = []

    def tell(text: str) -> None:
        warnings.append(f"{scans.source}: {text}")
        warn(warnings[-1])

    _look_at_scans(scans, tell)
    solution = solve(scans, wheels, config)
    located, joint = solution.localisation, solution.joint
    own = np.linalg.inv(located.informations + located.priors)
    of_keyframes = uncertainty.keyframe_covariances(joint.information, joint.poses)
    covariances = uncertainty.scan_covariances(of_keyframes, own[solution.keyframes], solution.nearest, own)
    covariances += uncertainty.unseen_covariances(
        seconds(scans.stamps_ns - scans.stamps_ns[0]), located.informations, _is_driven(scans, wheels)
    )
    odd_even = backwards = None
    if check_itself:
        odd_even = odd_against_even(scans, wheels, config, solution)
        backwards = backwards_against_forwards(scans, wheels, config, solution)
    mount = check_mount(scans.stamps_ns, located.poses, wheels)
    path = Path(scans.stamps_ns, located.poses)
    reference = Reference(path, covariances, scans, wheels, solution, odd_even, backwards, mount, warnings)
    _look_at_result(reference, tell)
    return reference


def _is_driven(scans: LaserScans, wheels: Optional[WheelMotions]) -> np.ndarray:
    """(N,) bool: scans to which and from which the wheels tell the motion."""
    if wheels is None:
        return np.zeros(len(scans), bool)
    covered = wheels.covers(scans.stamps_ns[:-1], scans.stamps_ns[1:])
    return np.append(True, covered) & np.append(covered, True)


def _look_at_scans(scans: LaserScans, tell: Callable[[str], None]) -> None:
    if scans.valid_share < FEW_RAYS:
        tell(f"only {100.0 * scans.valid_share:.0f} % of the rays have a valid range: dirt, glass, or nothing in reach")
    if np.hypot(*scans.T_base_laser[2, :2]) > LARGEST_TILT:
        tilt_deg = np.degrees(np.arcsin(min(1.0, float(np.hypot(*scans.T_base_laser[2, :2])))))
        if tilt_deg > 60.0:
            raise InputError(f"{scans.source}: the mount turns the plane of the scans by {tilt_deg:.0f} degrees")
        tell(
            f"the mount tilts the plane of the scans by {tilt_deg:.1f} degrees: walls are only straight if it is level"
        )
    if (scans.geometry[:, 2] == 0.0).all():
        tell("time_increment is 0: all rays of a scan are taken to be cast at once")


def _look_at_result(reference: Reference, tell: Callable[[str], None]) -> None:
    track, count = reference.solution.track, len(reference.scans)
    lost = int(np.count_nonzero(~track.is_matched))
    if lost > UNMATCHED * count:
        tell(f"{lost} of {count} scans fit nowhere; there the pose is {_by(reference)}, as its covariance says")
    corridor = int(np.count_nonzero(reference.is_corridor))
    if corridor > UNMATCHED * count:
        tell(
            f"{corridor} of {count} scans see a corridor, or walls in one direction only: along them the pose is "
            f"{_by(reference)}, as its covariance says"
        )
    mount = "" if reference.mount is None else reference.mount.describe()
    if mount:
        tell(mount)
    computed_m = float(np.sqrt(np.mean(reference.position_sigmas_m**2)))
    for name, found in (("odd and even scans", reference.odd_even), ("the way back", reference.backwards)):
        if found is not None and found.position_m > DISAGREEING * computed_m:
            tell(
                f"{name} differ by {1e3 * found.position_m:.1f} mm, more than the {1e3 * computed_m:.1f} mm that are "
                "computed: trust the difference"
            )


def _by(reference: Reference) -> str:
    return "that of the wheels" if reference.wheels is not None else "guessed from the motion before"
