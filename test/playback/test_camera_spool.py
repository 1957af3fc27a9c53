# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.io.trajectory import read_tum, write_tum
from ceiling_dso_ros.playback.camera_spool import CameraSpool
from ceiling_dso_ros.playback.spool import SpoolFolder
from ceiling_dso_ros.playback.spool_files import write_all
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder

BEGIN_NS = 1_732_800_000_123_456_789
FRAMES_A_KEYFRAME, WINDOW = 5, 4


def drive(count, lost_at=None, seed=0):
    """Statuses of images, of which every fifth is a keyframe, that are refined as long as they are in the window."""
    rng, window, segment = np.random.default_rng(seed), [], 0
    for index in range(count):
        stamp_ns = BEGIN_NS + index * 33_333_333
        if index == lost_at:
            window, segment = [], segment + 1
            yield OdometryStatus(stamp_ns, TrackingState.LOST, segment)
            continue
        keyframes = ()
        if not window or index % FRAMES_A_KEYFRAME == 0:
            window = [*window, (index, stamp_ns)]
            keyframes = tuple(
                KeyframeEstimate(key, stamp, segment, any_pose(rng), (0.0, 0.0), len(window) > WINDOW and place == 0)
                for place, (key, stamp) in enumerate(window)
            )
            window = window[-WINDOW:]
        yield OdometryStatus(
            stamp_ns,
            TrackingState.TRACKING,
            segment,
            T_world_camera=any_pose(rng),
            keyframe_id=window[-1][0],
            T_keyframe_camera=any_pose(rng),
            keyframes=keyframes,
        )


def any_pose(rng):
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


@pytest.fixture
def spool(tmp_path):
    return CameraSpool(SpoolFolder(tmp_path / "kept", "dso_node"), 10**6)


def saved(spool, folder):
    folder.mkdir()
    with spool.at_rest(), spool.beside(spool.newest()):
        written = write_all(spool.path, folder)
    assert written.errors == []
    return written.poses


@pytest.mark.parametrize("lost_at", [None, 43])
def test_the_files_are_those_of_a_run_that_was_kept_in_memory(spool, tmp_path, lost_at):
    recorder = TrajectoryRecorder()
    for index, status in enumerate(drive(100, lost_at)):
        recorder.add(status)
        spool.add(status)
        if index % 30 == 0:
            spool.flush()
    saved(spool, tmp_path / "disk")
    for name, make in recorder.files().items():
        write_tum(tmp_path / name, make())
        assert (tmp_path / "disk" / name).read_bytes() == (tmp_path / name).read_bytes()


def test_after_a_kill_the_poses_on_final_keyframes_are_there(spool, tmp_path):
    for status in drive(100):
        spool.add(status)
    spool.flush()
    (tmp_path / "out").mkdir()
    poses = write_all(spool.path, tmp_path / "out").poses
    final = 100 // FRAMES_A_KEYFRAME - WINDOW - 1  # one leaves with its last estimate, when the next status comes
    assert poses == {"camera.tum": 100, "keyframes.tum": final, "camera_final.tum": final * FRAMES_A_KEYFRAME}


def test_a_new_run_has_nothing_of_the_one_before(spool, tmp_path):
    for status in drive(100):
        spool.add(status)
    saved(spool, tmp_path / "first")
    spool.clear()
    statuses = list(drive(20, seed=1))
    for status in statuses:
        spool.add(status)
    assert saved(spool, tmp_path / "second") == {"camera.tum": 20, "keyframes.tum": 4, "camera_final.tum": 20}
    first = read_tum(tmp_path / "second" / "camera.tum").positions[0]
    assert np.allclose(first, statuses[0].T_world_camera[:3, 3], atol=1e-8)


def test_nothing_yet(spool, tmp_path):
    assert saved(spool, tmp_path / "out") == {"camera.tum": 0, "keyframes.tum": 0, "camera_final.tum": 0}


def test_an_unlimited_wait_for_the_disk_is_limited_in_memory(spool, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.playback.camera_spool.MOST_FRAMES", 10)
    for status in drive(25):
        spool.add(status)
    spool.flush()
    assert len(read_tum(spool.path / "camera.tum")) == 5
    assert spool.lost == 20
