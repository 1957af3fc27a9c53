# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder


def pose(x, yaw=0.0):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()
    T[0, 3] = x
    return T


def keyframe(keyframe_id, stamp_ns, T_world_camera, leaves=False, segment=0):
    return KeyframeEstimate(keyframe_id, stamp_ns, segment, T_world_camera, (0.0, 0.0), leaves)


def tracked(stamp_ns, T_world_camera, keyframe_id, T_keyframe_camera, keyframes=()):
    return OdometryStatus(
        stamp_ns,
        TrackingState.TRACKING,
        0,
        T_world_camera=T_world_camera,
        keyframe_id=keyframe_id,
        T_keyframe_camera=T_keyframe_camera,
        keyframes=keyframes,
    )


def recorder_of(*statuses):
    recorder = TrajectoryRecorder()
    for status in statuses:
        recorder.add(status)
    return recorder


def test_live_poses_stay_as_they_were_and_final_ones_follow_their_keyframe():
    recorder = recorder_of(
        tracked(1_000_000_000, pose(0.0), 0, np.eye(4), (keyframe(0, 1_000_000_000, pose(0.0)),)),
        tracked(2_000_000_000, pose(1.0), 0, pose(1.0)),
        tracked(
            3_000_000_000,
            pose(2.0),
            1,
            np.eye(4),
            (keyframe(0, 1_000_000_000, pose(0.5, yaw=np.pi / 2)), keyframe(1, 3_000_000_000, pose(2.1))),
        ),
    )
    assert recorder.live().stamps_ns.tolist() == [1_000_000_000, 2_000_000_000, 3_000_000_000]
    assert recorder.live().positions.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert np.allclose(recorder.final().positions, [[0.5, 0, 0], [0.5, 1, 0], [2.1, 0, 0]])
    assert np.allclose(recorder.final().matrices()[1], pose(0.5, yaw=np.pi / 2) @ pose(1.0))
    assert np.allclose(recorder.keyframes().positions, [[0.5, 0, 0], [2.1, 0, 0]])


def test_a_keyframe_that_left_keeps_its_last_estimate():
    recorder = recorder_of(
        tracked(
            1_000_000_000,
            pose(0.0),
            0,
            np.eye(4),
            (keyframe(0, 1_000_000_000, pose(0.0)), keyframe(1, 1_500_000_000, pose(1.0))),
        ),
        tracked(
            2_000_000_000,
            pose(1.0),
            1,
            pose(0.5),
            (keyframe(0, 1_000_000_000, pose(0.2), leaves=True), keyframe(1, 1_500_000_000, pose(1.1))),
        ),
        tracked(3_000_000_000, pose(2.0), 1, pose(1.0), (keyframe(1, 1_500_000_000, pose(1.3)),)),
    )
    assert np.allclose(recorder.keyframes().positions[:, 0], [0.2, 1.3])
    assert np.allclose(recorder.final().positions[:, 0], [0.2, 1.8, 2.3])


def test_frames_without_a_pose_leave_no_trace_but_their_keyframes_count():
    recorder = recorder_of(
        OdometryStatus(1_000_000_000, TrackingState.INITIALIZING, 0),
        tracked(2_000_000_000, pose(0.0), 0, np.eye(4), (keyframe(0, 1_000_000_000, pose(0.0)),)),
        OdometryStatus(3_000_000_000, TrackingState.LOST, 0),
        tracked(4_000_000_000, pose(0.0), 1, np.eye(4), (keyframe(1, 4_000_000_000, pose(0.0), segment=1),)),
    )
    assert recorder.live().stamps_ns.tolist() == recorder.final().stamps_ns.tolist() == [2_000_000_000, 4_000_000_000]
    assert recorder.keyframes().stamps_ns.tolist() == [1_000_000_000, 4_000_000_000]
    assert recorder.segments == 2


def test_nothing_recorded_gives_empty_trajectories():
    recorder = TrajectoryRecorder()
    assert len(recorder.live()) == len(recorder.final()) == len(recorder.keyframes()) == recorder.segments == 0


def test_a_frame_on_an_unknown_keyframe_is_refused():
    with pytest.raises(KeyError, match="unknown keyframe 7"):
        recorder_of(tracked(1_000_000_000, pose(0.0), 7, np.eye(4)))


def test_a_trajectory_that_somebody_still_has_does_not_stop_the_recorder():
    """A service writes its files while images go on."""
    recorder = recorder_of(tracked(1, pose(0.0), 0, np.eye(4), (keyframe(0, 1, pose(0.0)),)))
    kept = {name: make() for name, make in recorder.files().items()}
    recorder.add(tracked(2, pose(1.0), 0, pose(1.0)))
    assert [len(trajectory) for trajectory in kept.values()] == [1, 1, 1]
    assert len(recorder.live()) == 2
