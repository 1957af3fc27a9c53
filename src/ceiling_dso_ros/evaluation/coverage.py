# SPDX-License-Identifier: BSD-3-Clause
"""What a comparison of two trajectories leaves out: poses without a partner, and times without poses."""

from dataclasses import asdict, dataclass
from typing import Any, Dict, List, Tuple

import numpy as np

from ceiling_dso_ros.dso.durations import nanoseconds, seconds

GAP_S = 1.0  # at 3 images a second, the fewest that are tracked, two that fail in a row are not yet a gap


@dataclass(frozen=True)
class Coverage:
    """What was compared.

    Attributes:
        poses: of the estimate.
        pairs: those of them that have a partner in the reference.
        early, late: those that are stamped before the first pose of the reference, or after the last.
        unmatched: those in between without a reference pose near enough, or whose nearest one has a nearer partner.
        reference_s: time from the first pose of the reference to its last.
        missing_s: the parts of it before the first pair and after the last one, if longer than GAP_S.
        gaps_s: total time of longer gaps between two pairs, where the reference has poses.
        gaps: their number.
    """

    poses: int
    pairs: int
    early: int
    late: int
    unmatched: int
    reference_s: float
    missing_s: Tuple[float, float]
    gaps_s: float
    gaps: int

    @classmethod
    def of(
        cls, stamps_ns: np.ndarray, reference_ns: np.ndarray, index: np.ndarray, reference_index: np.ndarray
    ) -> "Coverage":
        """Of the increasing stamps of both, nanoseconds, and the indices of one or more pairs."""
        alone = np.ones(len(stamps_ns), bool)
        alone[index] = False
        early = int(np.count_nonzero(alone & (stamps_ns < reference_ns[0])))
        late = int(np.count_nonzero(alone & (stamps_ns > reference_ns[-1])))
        covered_ns = reference_ns[reference_index]
        ends_s = (seconds(covered_ns[0] - reference_ns[0]), seconds(reference_ns[-1] - covered_ns[-1]))
        begin_s, end_s = (float(end_s) if end_s > GAP_S else 0.0 for end_s in ends_s)
        own_steps_ns = np.diff(reference_ns)
        own_steps_ns[own_steps_ns > nanoseconds(GAP_S)] = 0  # gaps of the reference itself
        steps_ns = np.diff(np.concatenate([[0], np.cumsum(own_steps_ns)])[reference_index])
        is_gap = steps_ns > nanoseconds(GAP_S)
        return cls(
            poses=len(stamps_ns),
            pairs=len(index),
            early=early,
            late=late,
            unmatched=int(np.count_nonzero(alone)) - early - late,
            reference_s=float(seconds(reference_ns[-1] - reference_ns[0])),
            missing_s=(begin_s, end_s),
            gaps_s=float(seconds(int(steps_ns[is_gap].sum()))),
            gaps=int(np.count_nonzero(is_gap)),
        )

    def numbers(self) -> Dict[str, Any]:
        """All of it, as types that JSON supports."""
        return {**asdict(self), "missing_s": list(self.missing_s)}

    def describe(self, name: str, max_difference_s: float) -> List[str]:
        """Lines about what was left out; none if nothing was."""
        lines = []
        kinds = {
            "before the reference begins": self.early,
            "after it ends": self.late,
            f"without a reference pose of their own within {max_difference_s:g} s": self.unmatched,
        }
        if self.pairs < self.poses:
            parts = ", ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
            lines.append(f"{name}: {self.poses - self.pairs} of {self.poses} poses are not compared: {parts}")
        begin_s, end_s = self.missing_s
        times = {
            "at its beginning": begin_s,
            f"in {self.gaps} gap{'' if self.gaps == 1 else 's'}": self.gaps_s,
            "at its end": end_s,
        }
        missing_s = sum(times.values())
        if missing_s > 0.0:
            parts = ", ".join(f"{time_s:.1f} s {where}" for where, time_s in times.items() if time_s)
            lines.append(f"{name}: no poses for {missing_s:.1f} of {self.reference_s:.1f} s of the reference: {parts}")
        return lines
