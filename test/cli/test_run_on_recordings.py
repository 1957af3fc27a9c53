"""The main job on whole recordings: enough frames tracked, none lost, and accurate."""

import json
import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[3] / "shared" / "data"))

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("name", "min_tracked", "max_ate_m"), [("tum_fr1_xyz", 380, 0.030), ("ceiling_loops", 540, 0.006)]
)
def test_tracks_to_the_end_accurately_and_the_same_from_a_bag(command, bag_of, tmp_path, name, min_tracked, max_ate_m):
    folder = DATA / name
    if not folder.exists():
        pytest.skip(f"{folder} is missing: set CEILING_DSO_DATA to the folder of the recordings")
    out = tmp_path / "out"
    assert command("run", folder, "--out", out).returncode == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["lost"] == 0
    assert summary["tracked"] >= min_tracked

    assert command("evaluate", out, "--reference", folder / "groundtruth.tum").returncode == 0
    evaluation = json.loads((out / "evaluation.json").read_text())
    assert evaluation["trajectories"]["camera_final"]["ate_m"]["rmse"] <= max_ate_m

    assert command("run", bag_of(folder), "--out", tmp_path / "from_bag").returncode == 0
    for trajectory in ("camera.tum", "camera_final.tum", "keyframes.tum"):
        assert (tmp_path / "from_bag" / trajectory).read_bytes() == (out / trajectory).read_bytes()
