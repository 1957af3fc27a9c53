# SPDX-License-Identifier: BSD-3-Clause
"""The rows of runs.csv: one for each run, with what was varied, how it ended, and its numbers."""

import csv
import io
from typing import Any, Dict, List, Mapping, Sequence

KEYS = ("run", "sequence", "drive")
STATE = ("status", "message", "tries", "timed", "host")
RESULTS = (
    *("image", "rate_hz", "frames", "tracked", "lost", "skipped", "segments", "keyframes", "keyframe_share"),
    *("scale_known", "path_m", "ate_m", "ate_percent", "error_q1_m", "error_median_m", "error_q3_m", "live_ate_m"),
    *("fused_ate_m", "wheel_ate_m"),
)
TIMES = ("frame_ms", "frame_p95_ms", "keyframe_ms", "other_ms", "machine_ms", "run_s", "memory_mb")
# What differs between two executions of the same runs.
VOLATILE = ("tries", "host", *TIMES)

Row = Dict[str, Any]


def columns(dimensions: Sequence[str]) -> List[str]:
    """The names of all columns."""
    return [*KEYS, *dimensions, "seed", *STATE, *RESULTS, *TIMES]


def csv_of(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> bytes:
    """A table as CSV: numbers with all digits, nothing where a value is not known."""
    text = io.StringIO()
    writer = csv.DictWriter(text, names, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: _text(row.get(name)) for name in names})
    return text.getvalue().encode()


def _text(value: Any) -> Any:  # noqa: ANN401
    if value is None:
        return ""
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else value
