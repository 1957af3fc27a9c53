# SPDX-License-Identifier: BSD-3-Clause
"""The main job on whole recordings: enough frames tracked, none lost, and accurate."""

import json
import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[3] / "shared" / "data"))

MIN_TRACKED = {"tum_fr1_xyz": 380, "ceiling_loops": 540}
MAX_ATE_M = {"tum_fr1_xyz": 0.030, "ceiling_loops": 0.006}

pytestmark = pytest.mark.long


class Run:
    """A recording of a camera and what `run` made of it."""

    def __init__(self, folder, out):
        self.folder = folder
        self.out = out

    def read(self, name):
        return json.loads((self.out / name).read_text())


@pytest.fixture(scope="module", params=["tum_fr1_xyz", "ceiling_loops"])
def finished(request, command, tmp_path_factory):
    folder = DATA / request.param
    if not folder.exists():
        pytest.skip(f"{folder} is missing: set CEILING_DSO_DATA to the folder of the recordings")
    out = tmp_path_factory.mktemp("run")
    assert command("run", folder, "--out", out).returncode == 0
    return Run(folder, out)


def test_tracks_to_the_end(finished):
    summary = finished.read("summary.json")
    assert summary["lost"] == 0
    assert summary["tracked"] >= MIN_TRACKED[finished.folder.name]
    assert summary["warnings"] == []


def test_is_accurate(finished, command):
    assert command("evaluate", finished.out, "--reference", finished.folder / "groundtruth.tum").returncode == 0
    ate_m = finished.read("evaluation.json")["trajectories"]["camera_final"]["ate_m"]
    assert ate_m["rmse"] <= MAX_ATE_M[finished.folder.name]


def test_the_same_recording_as_a_bag_gives_the_same_bytes(finished, command, bag_of, tmp_path):
    """The bag has the camera alone: what the folder's wheels tell is left out."""
    from_folder, from_bag = finished.out, tmp_path / "bag"
    if (finished.folder / "encoders.csv").exists():
        from_folder = tmp_path / "folder"
        assert command("run", finished.folder, "--no-prediction", "--out", from_folder).returncode == 0
    assert command("run", bag_of(finished.folder), "--out", from_bag).returncode == 0
    for trajectory in ("camera.tum", "camera_final.tum", "keyframes.tum"):
        assert (from_bag / trajectory).read_bytes() == (from_folder / trajectory).read_bytes()
