# SPDX-License-Identifier: BSD-3-Clause
"""How sure the reference itself is, beside the errors that are measured against it.

A measured error contains that of the reference: squares add, as the two have nothing to do with each other. So an error
about as large as the reference's own says only that the estimate is not worse, and of two estimates the better one is
told only by a reference that is better than their difference.
"""

from dataclasses import asdict, dataclass
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.evaluation.report import TrajectoryEvaluation
from ceiling_dso_ros.io.pose_covariances import PoseCovariances

# Of a relative error that the reference's own part may be: with more, over an eighth of it may be the reference's.
LARGEST_SHARE = 0.5


@dataclass(frozen=True)
class ReferenceSigma:
    """Standard deviations of a reference: root mean squared distances of its positions from the truth, and of its yaw.

    Attributes:
        times_ns: (N,) int64 increasing; one for a sigma that is the same everywhere.
        position_m: (N,).
        yaw_rad: (N,), 0 where unknown.
    """

    times_ns: np.ndarray
    position_m: np.ndarray
    yaw_rad: np.ndarray

    @classmethod
    def constant(cls, position_m: float) -> "ReferenceSigma":
        """The same everywhere; nothing is known of the yaw."""
        return cls(np.zeros(1, np.int64), np.full(1, position_m), np.zeros(1))

    @classmethod
    def of(cls, covariances: PoseCovariances) -> "ReferenceSigma":
        """Of covariances of planar poses."""
        variances = np.einsum("nii->ni", covariances.matrices)
        return cls(
            covariances.stamps_ns, np.sqrt(variances[:, 0] + variances[:, 1]), np.sqrt(np.maximum(variances[:, 2], 0.0))
        )

    def at(self, stamps_ns: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Positions (M,) metres and yaws (M,) rad at (M,) stamps, interpolated."""
        times_s, wanted_s = (seconds(ns - self.times_ns[0]) for ns in (self.times_ns, stamps_ns))
        return np.interp(wanted_s, times_s, self.position_m), np.interp(wanted_s, times_s, self.yaw_rad)


@dataclass(frozen=True)
class RelativeSigma:
    """Standard deviation of the reference over parts of one length, and whether their errors are beyond it."""

    length_m: float
    translation_m: float
    good_enough: bool


@dataclass(frozen=True)
class ReferencePart:
    """What of the errors of one trajectory may be the reference's.

    Attributes:
        name: of the trajectory.
        rmse_m: its absolute error.
        position_m: root mean square over the pairs.
        yaw_deg: the same; 0 where unknown.
        relative: for each length of the relative errors.
    """

    name: str
    rmse_m: float
    position_m: float
    yaw_deg: float
    relative: Tuple[RelativeSigma, ...]

    def numbers(self) -> Dict[str, Any]:
        """As types that JSON supports."""
        return asdict(self)

    def describe(self) -> List[str]:
        """Lines for the user."""
        yaw = f", yaw {self.yaw_deg:.3f} degrees" if self.yaw_deg else ""
        lines = [f"{self.name}: ATE {self.rmse_m:.4f} m, the reference's own uncertainty {self.position_m:.4f} m{yaw}"]
        for each in self.relative:
            if not each.good_enough:
                lines.append(
                    f"{self.name}: * over {each.length_m:.2f} m the reference is not good enough: its own uncertainty "
                    f"is {each.translation_m:.4f} m"
                )
        return lines


def reference_part(evaluation: TrajectoryEvaluation, sigma: ReferenceSigma) -> ReferencePart:
    """The reference's part in an evaluation.

    The errors at both ends of a part of the trajectory count, as if they were independent, and the turn of its start.
    """
    position_m, yaw_rad = (float(np.sqrt(np.mean(each**2))) for each in sigma.at(evaluation.stamps_ns))
    relative = []
    for errors in evaluation.relative:
        own_m = float(np.sqrt(2.0 * position_m**2 + (yaw_rad * errors.length_m) ** 2))
        is_good = own_m <= LARGEST_SHARE * errors.translation_m.mean
        relative.append(RelativeSigma(errors.length_m, own_m, bool(is_good)))
    return ReferencePart(
        evaluation.name, evaluation.ate_m.rmse, position_m, float(np.degrees(yaw_rad)), tuple(relative)
    )


def ranking(parts: Sequence[ReferencePart]) -> List[List[str]]:
    """Names of trajectories, the best first; those that the reference does not tell from the best of them together."""
    ranks: List[List[ReferencePart]] = []
    for part in sorted(parts, key=lambda each: each.rmse_m):
        best = ranks[-1][0] if ranks else None
        if best is not None and part.rmse_m - best.rmse_m < max(part.position_m, best.position_m):
            ranks[-1].append(part)
        else:
            ranks.append([part])
    return [[part.name for part in rank] for rank in ranks]
