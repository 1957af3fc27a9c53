# SPDX-License-Identifier: BSD-3-Clause
"""What fusion_node says of itself in /diagnostics."""

from typing import Iterable, Optional, Sequence, Tuple

from diagnostic_updater import DiagnosticStatusWrapper

from ceiling_dso_ros.fusion.slip import SlipReport
from ceiling_dso_ros.fusion.state import FusedState, FusionState
from ceiling_dso_ros.msg import FusionStatus
from ceiling_dso_ros.ros import diagnostics


def summarize(
    status: DiagnosticStatusWrapper, state: Optional[FusedState], complaints: Iterable[Tuple[bytes, str]]
) -> None:
    """Summarize the newest state, and what there is to complain about: (level, text), without a text if all is well."""
    status.summary(diagnostics.OK, "no pose yet" if state is None else state.state.value)
    if state is not None and state.state is not FusionState.CONVERGED:
        status.mergeSummary(diagnostics.WARN, ", ".join(state.reasons))
    for level, text in complaints:
        if text:
            status.mergeSummary(level, text)


def add_figures(
    status: DiagnosticStatusWrapper,
    state: Optional[FusedState],
    slips: Sequence[SlipReport],
    counts: FusionStatus,
    lost: int,
) -> None:
    """Add how many results could not be kept, and once there is a state the scale, the slips and the newest time."""
    status.add("results not kept", str(lost))
    if state is None:
        return
    status.add("scale [m / VO unit]", f"{state.scale.value:.6g}")
    status.add("scale: relative sigma", f"{state.scale.sigma:.3g}")
    status.add("slips", str(len(slips)))
    status.add("processing [ms]", f"{counts.processing_ms:.1f}")
