# SPDX-License-Identifier: BSD-3-Clause
"""What dso_node says of itself in /diagnostics."""

from typing import Iterable, Optional

from diagnostic_updater import DiagnosticStatusWrapper

from ceiling_dso_ros.msg import VisualOdometryStatus
from ceiling_dso_ros.playback.frame_regulation import RateReason
from ceiling_dso_ros.ros import diagnostics
from ceiling_dso_ros.ros.motion_predictions import MotionPredictions

LEVELS = {VisualOdometryStatus.TRACKING: diagnostics.OK, VisualOdometryStatus.LOST: diagnostics.ERROR}
STATE_NAMES = {
    VisualOdometryStatus.WAITING: "waiting",
    VisualOdometryStatus.INITIALIZING: "initializing",
    VisualOdometryStatus.TRACKING: "tracking",
    VisualOdometryStatus.RETRYING: "retrying",
    VisualOdometryStatus.LOST: "lost",
    VisualOdometryStatus.RECOVERING: "recovering",
}


def summarize(
    report: DiagnosticStatusWrapper, status: VisualOdometryStatus, paused: bool, complaints: Iterable[str]
) -> None:
    """Summarize the newest state, and what there is to complain about; a text is empty if all is well."""
    text = f"{STATE_NAMES[status.state]}{': ' if status.message else ''}{status.message}"
    report.summary(LEVELS.get(status.state, diagnostics.WARN), text)
    if paused:
        report.summary(diagnostics.WARN, "paused")
    for complaint in complaints:
        if complaint:
            report.mergeSummary(diagnostics.WARN, complaint)


def add_figures(
    report: DiagnosticStatusWrapper,
    status: VisualOdometryStatus,
    left_out: Optional[int],
    lost: int,
    predictions: Optional[MotionPredictions],
) -> None:
    """Add figures of the last image that was used, how many were left out (None: the rate is not regulated), and more.

    Args:
        report: to which they are added.
        status: of the last image that was used.
        left_out: images so far that were left out.
        lost: results that could not be kept.
        predictions: of the wheels, if they are used.
    """
    if left_out is not None:
        why = RateReason(status.rate_reason).name.lower()
        report.add("left out", f"{left_out}; {status.rate:.1f} images a second are used, the last one: {why}")
    report.add("results not kept", str(lost))
    report.add("processing [ms]", f"{status.processing_ms:.1f}")
    report.add("photometric error [grey levels]", f"{status.rmse:.2f}")
    report.add("active points", str(status.active_points))
    report.add("segment", str(status.segment))
    if predictions is not None:
        report.add("motion predictions used", f"{predictions.used} of {predictions.asked}")
