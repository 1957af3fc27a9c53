# SPDX-License-Identifier: BSD-3-Clause
"""Evaluates trajectories against a reference and gives the results as JSON and as tables."""

from dataclasses import asdict, dataclass
from typing import AbstractSet, Any, Dict, Optional, Sequence, Tuple

import numpy as np
from tabulate import tabulate

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.evaluation.alignment import Alignment, AlignmentError, AlignmentKind, align
from ceiling_dso_ros.evaluation.association import associate, interpolate_poses
from ceiling_dso_ros.evaluation.coverage import Coverage
from ceiling_dso_ros.evaluation.errors import (
    RelativeErrors,
    Statistics,
    body_rotation_deg,
    distance_travelled_m,
    position_errors,
    relative_errors,
    rotation_errors,
)
from ceiling_dso_ros.io.trajectory import Trajectory

# Lengths of the sub-trajectories as parts of the whole path, as Zhang and Scaramuzza choose them.
RELATIVE_LENGTHS = (0.1, 0.2, 0.3, 0.4, 0.5)


class EvaluationError(ValueError):
    """The trajectories cannot be compared; the message says why and what to do."""


@dataclass(frozen=True)
class TrajectoryEvaluation:
    """One estimate against the reference.

    Attributes:
        name: of the trajectory.
        coverage: how many poses have a partner in the reference, P, and what was left out.
        alignment: the transformation of equation (14).
        aligned: (N, 4, 4) float64, all poses of the estimate after equation (15).
        stamps_ns: (P,) int64 nanoseconds of the pairs.
        travelled_m: (P,) float64, distance along the reference up to each pair.
        position_errors_m: (P,) float64, the paper's epsilon_i.
        rotation_errors_deg: (P,) float64; None where the alignment leaves the orientation open.
        body_rotation_deg: by how much the body of the reference is turned against that of the estimate; None where the
            alignment leaves the orientation open.
        relative: by length of the sub-trajectories.
    """

    name: str
    coverage: Coverage
    alignment: Alignment
    aligned: np.ndarray
    stamps_ns: np.ndarray
    travelled_m: np.ndarray
    position_errors_m: np.ndarray
    rotation_errors_deg: Optional[np.ndarray]
    body_rotation_deg: Optional[float]
    relative: Tuple[RelativeErrors, ...]

    @property
    def poses(self) -> int:
        """Number of poses of the estimate."""
        return self.coverage.poses

    @property
    def pairs(self) -> int:
        """Number of them that have a partner in the reference, P."""
        return self.coverage.pairs

    @property
    def ate_m(self) -> Statistics:
        """Absolute trajectory error."""
        return Statistics.of(self.position_errors_m)

    @property
    def path_m(self) -> float:
        """Length of the reference between the first and the last pair."""
        return float(self.travelled_m[-1])

    def numbers(self) -> Dict[str, Any]:
        """All results except the curves, as types that JSON supports."""
        rotation = None if self.rotation_errors_deg is None else asdict(Statistics.of(self.rotation_errors_deg))
        return {
            "alignment": self.alignment.kind.value,
            "scale": self.alignment.scale,
            "rotation_determined": self.alignment.rotation_determined,
            **self.coverage.numbers(),
            "path_m": self.path_m,
            "ate_m": asdict(self.ate_m),
            "rotation_deg": rotation,
            "body_rotation_deg": self.body_rotation_deg,
            "relative": [asdict(errors) for errors in self.relative],
        }


def evaluate_trajectory(
    name: str,
    estimate: Trajectory,
    reference: Trajectory,
    kind: AlignmentKind,
    max_difference_s: float,
    interpolate: bool = False,
) -> TrajectoryEvaluation:
    """Associate, align and compare: equations (13), (14), (15).

    Args:
        name: of the estimate.
        estimate: at least three poses.
        reference: poses of the same body.
        kind: which transformation aligns them.
        max_difference_s: tau of equation (13), seconds.
        interpolate: interpolate the reference at the stamps of the estimate, instead of taking its nearest poses.

    Raises:
        EvaluationError: no common time, fewer than three pairs, or no motion to take a scale from.
    """
    index, reference_index = _pairs(estimate, reference, max_difference_s)
    reference_poses = reference.matrices()[reference_index]
    if interpolate and len(reference) > 1:
        stamps_ns = np.clip(estimate.stamps_ns[index], reference.stamps_ns[0], reference.stamps_ns[-1])
        reference_poses = interpolate_poses(reference.stamps_ns, reference.matrices(), stamps_ns)
    poses = estimate.matrices()
    try:
        alignment = align(poses[index, :3, 3], reference_poses[:, :3, 3], kind)
    except AlignmentError as error:
        raise EvaluationError(str(error)) from error

    aligned, planar = alignment.apply(poses), kind.planar
    travelled_m = distance_travelled_m(reference_poses, planar)
    lengths_m = travelled_m[-1] * np.array(RELATIVE_LENGTHS)
    return TrajectoryEvaluation(
        name=name,
        coverage=Coverage.of(estimate.stamps_ns, reference.stamps_ns, index, reference_index),
        alignment=alignment,
        aligned=aligned,
        stamps_ns=estimate.stamps_ns[index],
        travelled_m=travelled_m,
        position_errors_m=position_errors(aligned[index], reference_poses, planar),
        rotation_errors_deg=(
            rotation_errors(aligned[index], reference_poses, planar) if alignment.rotation_determined else None
        ),
        body_rotation_deg=(
            body_rotation_deg(aligned[index], reference_poses) if alignment.rotation_determined else None
        ),
        relative=relative_errors(aligned[index], reference_poses, lengths_m[lengths_m > 0.0], planar),
    )


def tables(evaluations: Sequence[TrajectoryEvaluation], doubtful: AbstractSet[Tuple[str, float]] = frozenset()) -> str:
    """The absolute and the relative errors, one table each.

    Args:
        evaluations: of all trajectories.
        doubtful: name and length of relative errors that are marked with a star.
    """
    absolute = [_absolute_row(evaluation) for evaluation in evaluations]
    relative = [
        _relative_row(evaluation.name, errors, (evaluation.name, errors.length_m) in doubtful)
        for evaluation in evaluations
        for errors in evaluation.relative
    ]
    return "\n\n".join(
        tabulate(rows, headers="keys", disable_numparse=True, colalign=("left", *["right"] * (len(rows[0]) - 1)))
        for rows in (absolute, relative)
        if rows
    )


def _absolute_row(evaluation: TrajectoryEvaluation) -> Dict[str, str]:
    ate_m, rotation_deg = evaluation.ate_m, evaluation.rotation_errors_deg
    return {
        "trajectory": evaluation.name,
        "align": evaluation.alignment.kind.value,
        "pairs": str(evaluation.pairs),
        "path m": f"{evaluation.path_m:.2f}",
        "scale": f"{evaluation.alignment.scale:.4f}",
        "ATE rmse m": f"{ate_m.rmse:.4f}",
        "mean": f"{ate_m.mean:.4f}",
        "median": f"{ate_m.median:.4f}",
        "max": f"{ate_m.max:.4f}",
        "rotation deg": "-" if rotation_deg is None else f"{Statistics.of(rotation_deg).rmse:.3f}",
    }


def _relative_row(name: str, errors: RelativeErrors, is_doubtful: bool) -> Dict[str, str]:
    return {
        "trajectory": name,
        "length m": f"{'* ' if is_doubtful else ''}{errors.length_m:.2f}",
        "parts": str(errors.count),
        "translation %": f"{errors.translation_percent.mean:.3f}",
        "rotation deg/m": f"{errors.rotation_deg_per_m.mean:.4f}",
        "yaw deg/m": f"{errors.yaw_deg_per_m.mean:.4f}",
    }


def _pairs(estimate: Trajectory, reference: Trajectory, max_difference_s: float) -> Tuple[np.ndarray, np.ndarray]:
    """Equation (13); the error message says what to do if there are too few pairs."""
    index, reference_index = associate(estimate.stamps_ns, reference.stamps_ns, max_difference_s)
    if len(index) == 0:
        ranges = f"it covers {_range(estimate)}, the reference {_range(reference)}"
        if estimate.stamps_ns[0] > reference.stamps_ns[-1] or estimate.stamps_ns[-1] < reference.stamps_ns[0]:
            raise EvaluationError(f"no overlap in time: {ranges}")
        raise EvaluationError(f"no stamps within {max_difference_s} s of each other; {ranges}: raise --max-difference")
    return index, reference_index


def _range(trajectory: Trajectory) -> str:
    return f"{seconds(trajectory.stamps_ns[0]):.3f} to {seconds(trajectory.stamps_ns[-1]):.3f} s"
