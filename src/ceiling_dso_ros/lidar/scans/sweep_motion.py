# SPDX-License-Identifier: BSD-3-Clause
"""How the robot moves during each scan, from poses that are known already.

The difference of two poses has the noise of both, and over a tenth of a second that is a large error of a velocity.
With wheels, only their constants come from the poses, by all of the drive at once. Without, polynomials through several
poses are used.
"""

from typing import Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.io.laser_scans import LaserScans
from ceiling_dso_ros.lidar.scans.poses import between, logmap, wrap
from ceiling_dso_ros.lidar.scans.scan_points import ScanPoints, steady
from ceiling_dso_ros.lidar.scans.wheel_motion import WheelMotions

HALF_WINDOW, DEGREE = 3, 3  # scans before and after that a polynomial goes through
LONGEST_WINDOW_S = 1.5  # from the first of them to the last: over a longer time the motion is no polynomial
LONGEST_STEP_S = 0.5  # from scan to scan, over which a change of the twist is even
STRIDE = 10  # scans from one pose to the next, from which the constants of the wheels are found
SLIP_M, SLIP_RAD = 0.02, 0.01  # from scan to scan: where the wheels differ more from the poses, they are not used
BEYOND_S = 0.04  # before and after a scan, over which the wheels' twist is taken: they have a resolution, too
ITERATIONS = 5


def sweep_motions(
    scans: LaserScans, points: ScanPoints, wheels: Optional[WheelMotions], poses: np.ndarray, known: np.ndarray
) -> np.ndarray:
    """Motions (N, 2, 3) during the scans: the twist at the stamp, m/s, m/s, rad/s, and its change per second.

    Args:
        scans: all of them.
        points: of them.
        wheels: how the robot moved between; None where no wheels told.
        poses: (N, 3) at the stamps.
        known: (N, 3) twists that are kept where scans are too far from each other in time.
    """
    if len(poses) < 2:
        return steady(known)
    twists = _smooth_twists(scans, poses, known)
    if wheels is not None:
        twists = _driven_twists(scans, points, wheels, poses, twists)
    middles_s = seconds(scans.stamps_ns - scans.stamps_ns[0]) + 0.5 * scans.sweep_s
    changes = np.gradient(twists, middles_s, axis=0)
    near = np.gradient(middles_s) < LONGEST_STEP_S
    changes = np.where(near[:, None], changes, 0.0)
    return np.stack([twists - 0.5 * scans.sweep_s[:, None] * changes, changes], axis=1)


def _driven_twists(
    scans: LaserScans, points: ScanPoints, wheels: WheelMotions, poses: np.ndarray, otherwise: np.ndarray
) -> np.ndarray:
    """Mean twists (N, 3) during the scans by the wheels; the other ones where wheels slip, or tell nothing."""
    ahead, turn = _wheel_constants(scans.stamps_ns, poses, wheels)
    stamps_ns, ends_ns = scans.stamps_ns, points.end_stamps_ns
    from_ns, to_ns = stamps_ns - nanoseconds(BEYOND_S), ends_ns + nanoseconds(BEYOND_S)
    mean = logmap(wheels.between(from_ns, to_ns)) / seconds(to_ns - from_ns)[:, None]
    driven = _corrected(mean, ahead, turn)
    steps = _corrected(logmap(wheels.between(stamps_ns[:-1], stamps_ns[1:])), ahead, turn)
    apart = np.abs(steps - logmap(between(poses[:-1], poses[1:])))
    agrees = (apart[:, :2].max(axis=1) < SLIP_M) & (apart[:, 2] < SLIP_RAD)
    agrees = np.append(agrees, True) & np.append(True, agrees)  # the steps before and after a scan
    used = agrees & wheels.covers(from_ns, to_ns)
    return np.where(used[:, None], driven, otherwise)


def _smooth_twists(scans: LaserScans, poses: np.ndarray, known: np.ndarray) -> np.ndarray:
    """By least squares polynomials of x, y and yaw, seen from each pose, at the middle of its scan."""
    count = len(poses)
    width = min(2 * HALF_WINDOW + 1, count)
    first = np.clip(np.arange(count) - width // 2, 0, count - width)
    index = first[:, None] + np.arange(width)
    times_s = seconds(scans.stamps_ns[index] - scans.stamps_ns[:, None])
    seen = between(np.repeat(poses[:, None], width, axis=1), poses[index])
    seen[..., 2] = wrap(seen[..., 2])
    degree = min(DEGREE, width - 1)
    powers = times_s[..., None] ** np.arange(degree + 1)
    coefficients = np.linalg.pinv(powers) @ seen  # (N, degree + 1, 3)
    middle_s = 0.5 * scans.sweep_s[:, None]
    orders = np.arange(1, degree + 1)
    rates = np.einsum("nk,nkj->nj", orders * middle_s ** (orders - 1), coefficients[:, 1:])
    yaw = np.einsum("nk,nk->n", middle_s ** np.arange(degree + 1), coefficients[..., 2])
    c, s = np.cos(yaw), np.sin(yaw)
    twists = np.column_stack([c * rates[:, 0] + s * rates[:, 1], c * rates[:, 1] - s * rates[:, 0], rates[:, 2]])
    near = np.ptp(times_s, axis=1) < LONGEST_WINDOW_S
    return np.where(near[:, None], twists, known)


def _corrected(twists: np.ndarray, ahead: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Twists of the wheels (N, 3) by their constants: ahead and turn by (2,) factors of ahead and turn."""
    pairs = twists[:, [0, 2]]
    return np.column_stack([pairs @ ahead, twists[:, 1], pairs @ turn])


def _wheel_constants(stamps_ns: np.ndarray, poses: np.ndarray, wheels: WheelMotions) -> Tuple[np.ndarray, np.ndarray]:
    """(2,) factors each that make the wheels' ahead and turn those of the poses; slips count little."""
    index = np.unique(np.append(np.arange(0, len(poses), STRIDE), len(poses) - 1))
    from_ns, to_ns = stamps_ns[index[:-1]], stamps_ns[index[1:]]
    covered = wheels.covers(from_ns, to_ns)
    said = logmap(wheels.between(from_ns, to_ns))[covered][:, [0, 2]]
    done = logmap(between(poses[index[:-1]], poses[index[1:]]))[covered]
    nominal = np.eye(2)
    factors = []
    for column, own in ((0, nominal[0]), (2, nominal[1])):
        weights, found = np.ones(len(said)), own
        for _ in range(ITERATIONS):
            normal = said.T @ (weights[:, None] * said) + 1e-3 * np.eye(2)  # little motion: as they are
            found = own + np.linalg.solve(normal, said.T @ (weights * (done[:, column] - said @ own)))
            apart = np.abs(done[:, column] - said @ found)
            scale = max(3.0 * float(np.median(apart)) if len(apart) else 0.0, 1e-4)
            weights = 1.0 / (1.0 + (apart / scale) ** 2)
        factors.append(found)
    return factors[0], factors[1]
