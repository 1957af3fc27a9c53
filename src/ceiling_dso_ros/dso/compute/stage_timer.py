# SPDX-License-Identifier: BSD-3-Clause
"""Milliseconds per stage of one frame."""

import time
from contextlib import contextmanager
from typing import Dict, Iterator, Mapping


class StageTimer:
    """Adds up the time spent in named stages."""

    def __init__(self) -> None:
        self.timing_ms: Dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of the with block towards a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add({name: 1e3 * (time.perf_counter() - start)})

    def add(self, timing_ms: Mapping[str, float]) -> None:
        """Add the stages of another timer."""
        for name, milliseconds in timing_ms.items():
            self.timing_ms[name] = self.timing_ms.get(name, 0.0) + milliseconds
