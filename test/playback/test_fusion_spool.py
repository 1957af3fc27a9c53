# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.fusion.config import FusionConfig, GraphConfig
from ceiling_dso_ros.fusion.motion import MOTION
from ceiling_dso_ros.fusion.smoothing import smooth
from ceiling_dso_ros.fusion.state import FusedState, FusionState, ScaleState
from ceiling_dso_ros.io.rolling_file import old_part
from ceiling_dso_ros.io.trajectory import read_tum, write_tum
from ceiling_dso_ros.playback.fused_record import FusedRecord, smoothed_trajectory
from ceiling_dso_ros.playback.fusion_spool import FusionSpool, kept_motions
from ceiling_dso_ros.playback.spool import SpoolFolder
from ceiling_dso_ros.playback.spool_files import write_all

BEGIN_NS = 1_732_800_000_123_456_789
STEP_M, SCALE = 0.1, 4.0
NOWHERE = np.zeros(3)


def motions(count, begin=1):
    """Straight on; the camera sees nothing in the first."""
    result = np.zeros(count, MOTION)
    result["end"] = np.arange(begin, begin + count)
    result["stamp_ns"] = BEGIN_NS + result["end"] * 200_000_000
    result["start_pose"][:, 0] = STEP_M * (result["end"] - 1)
    result["wheels"][:, 0] = STEP_M
    result["wheels_covariance"] = np.diag([1e-3, 1e-3, 1e-3]) ** 2
    result["is_seen"] = result["continues"] = result["end"] > 1
    result["shift"][:, 0] = STEP_M / SCALE
    result["visual_covariance"] = np.diag([1e-4, 1e-4, 1e-4]) ** 2
    result["walk_sigma"], result["log_scale"] = 1e-4, (np.log(SCALE), 1.0)
    return result


def outputs(count, begin=0):
    scale = ScaleState(SCALE, 0.01, True, 0)
    for index in range(begin, begin + count):
        pose = np.array([0.02 * index, 0.1, 3.0 + 0.1 * index])
        yield FusedState(
            BEGIN_NS + 20_000_000 * index, pose, np.eye(3), np.zeros(2), np.eye(2), FusionState.CONVERGED, (), scale
        )


@pytest.fixture
def spool(tmp_path):
    return FusionSpool(SpoolFolder(tmp_path / "kept", "fusion_node"), 10**6, FusionConfig())


def saved(spool, folder, newest=motions(0), origin=NOWHERE):
    folder.mkdir()
    with spool.at_rest(), spool.beside(spool.newest(newest, origin)):
        written = write_all(spool.path, folder)
    assert written.errors == []
    return written.poses


def test_the_files_are_those_of_a_run_that_was_kept_in_memory(spool, tmp_path):
    record, measured = FusedRecord(), motions(30)
    for state in outputs(100):
        record.add(state, state.pose + 1.0)
        spool.add(state, state.pose + 1.0)
        if state.stamp_ns == BEGIN_NS + 20_000_000 * 50:
            spool.flush()
    spool.add_motions(measured[:20])
    assert saved(spool, tmp_path / "disk", measured[20:]) == {
        "wheel.tum": 100,
        "fused.tum": 100,
        "fused_smoothed.tum": 30,
    }
    (tmp_path / "memory").mkdir()
    smoothed = smoothed_trajectory(smooth(measured, FusionConfig()))
    for name, trajectory in (("wheel", record.wheel()), ("fused", record.fused()), ("fused_smoothed", smoothed)):
        write_tum(tmp_path / "memory" / f"{name}.tum", trajectory)
        assert (tmp_path / "disk" / f"{name}.tum").read_bytes() == (tmp_path / "memory" / f"{name}.tum").read_bytes()


def test_results_go_on_while_they_are_saved(spool, tmp_path):
    measured = motions(40)
    spool.add_motions(measured[:20])
    newest = spool.newest(measured[20:30], NOWHERE)
    spool.add_motions(measured[20:35])  # before the files are at rest
    (tmp_path / "first").mkdir()
    with spool.at_rest(), spool.beside(newest):
        for state in outputs(10):
            spool.add(state, NOWHERE)
        assert write_all(spool.path, tmp_path / "first").poses == {
            "wheel.tum": 0,
            "fused.tum": 0,
            "fused_smoothed.tum": 35,
        }
    assert saved(spool, tmp_path / "second", measured[35:])["fused.tum"] == 10
    assert len(read_tum(tmp_path / "second" / "fused_smoothed.tum")) == 40


def test_the_smoothed_trajectory_is_in_odom(spool, tmp_path):
    spool.add_motions(motions(10))
    saved(spool, tmp_path / "out", origin=np.array([5.0, 6.0, np.pi / 2]))
    assert np.allclose(read_tum(tmp_path / "out" / "fused_smoothed.tum").positions[-1], [5.0, 7.0, 0.0], atol=1e-6)


def test_after_a_kill_the_keyframes_that_were_final_are_there(spool, tmp_path):
    for state in outputs(10):
        spool.add(state, NOWHERE)
    spool.add_motions(motions(25))
    spool.flush()
    (tmp_path / "out").mkdir()
    assert write_all(spool.path, tmp_path / "out").poses == {"wheel.tum": 10, "fused.tum": 10, "fused_smoothed.tum": 25}


def test_a_new_run_has_nothing_of_the_one_before(spool, tmp_path):
    for state in outputs(10):
        spool.add(state, NOWHERE)
    spool.add_motions(motions(10))
    saved(spool, tmp_path / "first", motions(5, begin=11))
    spool.clear()
    spool.add_motions(motions(3))
    for state in outputs(4):
        spool.add(state, NOWHERE)
    assert saved(spool, tmp_path / "second") == {"wheel.tum": 4, "fused.tum": 4, "fused_smoothed.tum": 3}


def test_of_a_long_drive_the_newest_part_is_kept_and_smoothed_where_it_was(tmp_path):
    limit = int(40 * MOTION.itemsize / 0.14)
    spool = FusionSpool(SpoolFolder(tmp_path / "kept", "fusion_node"), limit, FusionConfig())
    for measured in motions(200):
        spool.add_motions([measured])
        spool.flush()
    assert (spool.path / "motions.bin").stat().st_size + old_part(spool.path / "motions.bin").stat().st_size <= limit
    kept = kept_motions(spool.path)
    assert 20 <= len(kept) <= 40
    assert kept["end"].tolist() == [*range(201 - len(kept), 201)]
    saved(spool, tmp_path / "out")
    assert np.allclose(read_tum(tmp_path / "out" / "fused_smoothed.tum").positions[-1], [200 * STEP_M, 0, 0], atol=1e-6)


@pytest.mark.parametrize(("gap", "kept"), [(10, range(16, 31)), (20, range(1, 21))])
def test_of_a_drive_with_a_gap_the_longer_part_is_smoothed(spool, gap, kept):
    """The disk was full for a while."""
    measured = motions(30)
    spool.add_motions([*measured[:gap], *measured[gap + 5 :]])
    spool.flush()
    assert kept_motions(spool.path)["end"].tolist() == [*kept]


def no_walk(damaged):
    damaged["walk_sigma"][:] = 1e-300


def no_sigma_of_the_guess(damaged):
    damaged["log_scale"][:, 1] = 0.0


def no_sigma_of_a_second_camera(damaged):
    damaged["has_stereo"], damaged["stereo"] = True, (1.0, 1e-300, 0.003)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("damage", [no_walk, no_sigma_of_the_guess, no_sigma_of_a_second_camera])
def test_a_scale_of_infinite_information_is_damaged(spool, tmp_path, damage):
    measured = motions(20)
    damage(measured[15:])
    spool.add_motions([*measured])
    spool.flush()
    assert kept_motions(spool.path)["end"].tolist() == [*range(1, 16)]
    with spool.at_rest(), spool.beside(spool.newest(motions(0), NOWHERE)):
        written = write_all(spool.path, tmp_path)
    assert written.poses["fused_smoothed.tum"] == 15
    (error,) = written.errors
    assert "5 of its 20 records are damaged" in error


def test_the_settings_of_the_run_are_those_of_its_smoothing(tmp_path):
    """With another ratio of the wheels, which only an estimate of it can follow."""
    config = FusionConfig(graph=GraphConfig(estimate_wheels=True))
    spool = FusionSpool(SpoolFolder(tmp_path / "kept", "fusion_node"), 10**6, config)
    measured = motions(30)
    measured["by_constants"][:, 2, 0] = 0.2
    measured["wheels"][:, 2] = 2e-3
    spool.add_motions(measured)
    saved(spool, tmp_path / "out")
    expected = smoothed_trajectory(smooth(measured, config))
    assert np.allclose(read_tum(tmp_path / "out" / "fused_smoothed.tum").positions, expected.positions, atol=1e-8)
    assert not np.allclose(
        expected.positions, smoothed_trajectory(smooth(measured, FusionConfig())).positions, atol=1e-6
    )


def test_an_unlimited_wait_for_the_disk_is_limited_in_memory(spool, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.playback.fusion_spool.MOST_OUTPUTS", 10)
    for state in outputs(25):
        spool.add(state, NOWHERE)
    spool.flush()
    assert len(read_tum(spool.path / "fused.tum")) == 5
    assert spool.lost == 20
