# SPDX-License-Identifier: BSD-3-Clause
"""Measured values beside their limits."""

import math
from dataclasses import dataclass
from typing import List, Sequence, Union

import numpy as np
from tabulate import tabulate


@dataclass(frozen=True)
class Row:
    """One limit: it holds when all values lie within [low, high]."""

    subject: str
    measure: str
    values: Union[Sequence[float], np.ndarray]
    high: float = math.inf
    low: float = -math.inf

    @property
    def holds(self) -> bool:
        """Whether the limit holds."""
        return len(self.values) > 0 and all(self.low <= value <= self.high for value in self.values)

    def cells(self) -> List[str]:
        """The row as text."""
        values = "  ".join(f"{v:.3g}" for v in self.values)
        if math.isinf(self.low) and math.isinf(self.high):
            return [self.subject, self.measure, values, "", ""]
        low, high = f"{self.low:.4g}", f"{self.high:.4g}"
        limit = f"<= {high}" if self.low == -math.inf else f">= {low}" if self.high == math.inf else f"{low} to {high}"
        return [self.subject, self.measure, values, limit, _yes(self.holds)]


def report(rows: Sequence[Row]) -> str:
    """All rows as a table."""
    headers = ["", "measure", "values", "limit", "holds"]
    return tabulate([row.cells() for row in rows], headers=headers, disable_numparse=True)


def _yes(holds: bool) -> str:
    return "yes" if holds else "NO"
