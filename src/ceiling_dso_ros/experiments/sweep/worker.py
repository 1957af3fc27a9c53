# SPDX-License-Identifier: BSD-3-Clause
"""Process that carries out runs: `python3 -m ceiling_dso_ros.experiments.sweep.worker`; it loads the kernels once."""

import sys
from pathlib import Path
from typing import Any, Dict

import cv2

from ceiling_dso_ros.dso.warmup import load_kernels
from ceiling_dso_ros.experiments.sweep.answering import answer_jobs
from ceiling_dso_ros.experiments.sweep.one_run import carry_out
from ceiling_dso_ros.experiments.sweep.run_spec import RunSpec


def _prepare() -> None:
    cv2.setNumThreads(1)
    load_kernels(lambda message: print(message, file=sys.stderr))


def _work(spec: Dict[str, Any], folder: Path, timed: bool) -> Dict[str, Any]:
    return carry_out(RunSpec.from_json(spec), folder, timed)


if __name__ == "__main__":
    answer_jobs(_prepare, _work)
