# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace
from pathlib import Path

import pytest

from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.experiments.sweep import plan, supervision
from ceiling_dso_ros.experiments.sweep.conditions import Conditions
from ceiling_dso_ros.experiments.sweep.run_spec import Opening, RunSpec
from ceiling_dso_ros.fusion.config import FusionConfig


@pytest.fixture
def spec_of(tmp_path):
    """A run whose sequence says what it does in the acting worker."""

    def make(sequence="drive", seed=0, **changes):
        path = tmp_path / "drive.bag"
        path.write_text("a drive")
        spec = RunSpec(
            sequence, str(path), None, None, Opening(), {}, Conditions(), OdometryConfig(), FusionConfig(), seed
        )
        return replace(spec, **changes)

    return make


@pytest.fixture
def acting(monkeypatch):
    """The local executor uses the acting worker, and recordings need not exist."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setattr(supervision.SupervisedWorker.__init__, "__defaults__", ("acting_worker",))
    monkeypatch.setattr(plan.Plan, "_references", lambda self, path: (None, None))
