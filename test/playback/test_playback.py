# SPDX-License-Identifier: BSD-3-Clause
import json
import signal

import numpy as np
import pytest

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.recording import Frame, SkippedFrame
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.io.warning_log import WarningLog
from ceiling_dso_ros.playback.playback import Playback
from ceiling_dso_ros.playback.visual_run import VisualRun


def a_point_of(keyframe_id, depth):
    return HostedPoints(np.array([keyframe_id]), np.array([[0.0, 0.0, depth]]), np.array([40.0], np.float32))


class FakeOdometry:
    """Waits for two frames, then moves 1 a frame; every third tracked frame becomes a keyframe; frame 6 is lost."""

    def __init__(self):
        self.seen = []

    def track(self, image, stamp_ns, exposure_ms, prediction=None, right=None):
        index = len(self.seen)
        self.seen.append((image, stamp_ns, exposure_ms))
        if index < 2:
            return OdometryStatus(stamp_ns, TrackingState.INITIALIZING, 0, message=f"first {index}")
        if index == 6:
            return OdometryStatus(stamp_ns, TrackingState.LOST, 0, message="lost")
        segment, keyframe_id = int(index > 6), index // 3
        T_world_camera, T_keyframe_camera, T_world_keyframe = (np.eye(4) for _ in range(3))
        T_world_camera[0, 3], T_keyframe_camera[0, 3] = index, index - 3 * keyframe_id
        T_world_keyframe[0, 3] = 3.1 * keyframe_id
        keyframe = KeyframeEstimate(keyframe_id, 3 * 10**9 * keyframe_id, segment, T_world_keyframe, (0.0, 0.0), False)
        return OdometryStatus(
            stamp_ns,
            TrackingState.TRACKING,
            segment,
            T_world_camera=T_world_camera,
            is_keyframe=index % 3 == 0,
            keyframe_id=keyframe_id,
            T_keyframe_camera=T_keyframe_camera,
            keyframes=(keyframe,),
            window_points=a_point_of(keyframe_id, 2.0),
            marginalized=a_point_of(keyframe_id, 5.0),
            timing_ms={"track": 1.5},
        )


def frames(count):
    for index in range(count):
        yield Frame(index * 10**9, 0.1 * index, np.full((2, 3), index, np.uint8))


class InterruptedOdometry(FakeOdometry):
    """Ctrl-C comes in the midst of frame 3."""

    def track(self, image, stamp_ns, exposure_ms, prediction=None, right=None):
        if len(self.seen) == 3:
            signal.raise_signal(signal.SIGINT)
        return super().track(image, stamp_ns, exposure_ms)


def test_an_interrupt_waits_for_the_end_of_the_frame(interruptible):
    playback = Playback(VisualRun(lambda image: image + 100.0, InterruptedOdometry()), WarningLog(print))
    with pytest.raises(KeyboardInterrupt):
        playback.play(frames(6))
    assert playback.summary()["frames"] == 4


def playback_of(stream):
    warnings = []
    playback = Playback(VisualRun(lambda image: image + 100.0, FakeOdometry()), WarningLog(warnings.append))
    playback.play(stream)
    return playback, warnings


def test_every_frame_reaches_the_odometry_after_preprocessing():
    odometry = FakeOdometry()
    Playback(VisualRun(lambda image: image + 100.0, odometry), WarningLog(print)).play(frames(4))
    assert [stamp_ns for _, stamp_ns, _ in odometry.seen] == [0, 10**9, 2 * 10**9, 3 * 10**9]
    assert [exposure_ms for _, _, exposure_ms in odometry.seen] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [image[0, 0] for image, _, _ in odometry.seen] == [100.0, 101.0, 102.0, 103.0]


class Wheels:
    """Stands for the fusion: says of every image how far the camera has come."""

    def predicted_motion(self, last, stamp_ns):
        T_last_camera = np.eye(4)
        T_last_camera[0, 3] = seconds(stamp_ns - last.predict_from_ns)
        return CameraMotion(T_last_camera, np.zeros((6, 6)))

    def add(self, status):
        pass

    def finish(self):
        pass


class PredictedOdometry(FakeOdometry):
    """Keeps what it is told besides."""

    def __init__(self):
        super().__init__()
        self.predictions = []

    def track(self, image, stamp_ns, exposure_ms, prediction=None, right=None):
        self.predictions.append(prediction)
        return super().track(image, stamp_ns, exposure_ms)


def test_the_wheels_predict_the_motion_since_the_image_that_is_asked_for():
    odometry = PredictedOdometry()
    Playback(VisualRun(lambda image: image, odometry), WarningLog(print), Wheels()).play(frames(8))
    assert odometry.predictions[0] is None
    since = [prediction.T_start_end[0, 3] for prediction in odometry.predictions[1:]]
    assert since == [1.0] * 7

    unasked = PredictedOdometry()
    Playback(VisualRun(lambda image: image, unasked), WarningLog(print), Wheels(), predict=False).play(frames(3))
    assert unasked.predictions == [None, None, None]


def test_summary_counts():
    playback, _ = playback_of(frames(9))
    summary = playback.summary()
    counts = {name: summary[name] for name in ("frames", "tracked", "lost", "keyframes", "segments")}
    assert counts == {"frames": 9, "tracked": 6, "lost": 1, "keyframes": 3, "segments": 2}
    assert summary["scale"] == {"value": None, "sigma": None, "converged": False}


def test_skipped_frames_are_warned_of_and_counted_apart():
    bad = [SkippedFrame(1_500_000_000 + n, f"0000{n}.png: truncated; frame skipped", "truncated") for n in range(3)]
    playback, warnings = playback_of([*frames(2), *bad, Frame(2 * 10**9, None, np.zeros((2, 3), np.uint8))])
    assert warnings == ["00000.png: truncated; frame skipped"]
    summary = playback.summary()
    assert summary["warnings"] == ["00000.png: truncated; frame skipped ... and 2 more"]
    assert (summary["frames"], summary["skipped"]) == (3, 3)


def test_a_lost_map_is_said_with_its_time_and_reason():
    _, warnings = playback_of(frames(9))
    assert warnings == ["the map was lost at 6.000000000: lost"]


def test_when_no_frame_can_be_used_the_first_reason_is_the_error():
    bad = [SkippedFrame(None, f"message {n}: bad size; frame skipped", "bad size") for n in range(159)]
    warnings = []
    playback = Playback(VisualRun(lambda image: image, FakeOdometry()), WarningLog(warnings.append))
    with pytest.raises(InputError, match="none of the 159 images can be used; the first: message 0: bad size"):
        playback.play(bad)
    assert warnings == []
    with pytest.raises(InputError, match="there are no images"):
        Playback(VisualRun(lambda image: image, FakeOdometry()), WarningLog(print)).play([])


def test_frames_that_are_skipped_before_the_first_are_warned_of_too():
    bad = SkippedFrame(None, "message 1: bad size; frame skipped", "bad size")
    assert playback_of([bad, *frames(1)])[1] == ["message 1: bad size; frame skipped"]


def test_the_most_frequent_reason_for_frames_without_a_pose():
    playback, _ = playback_of(frames(9))
    assert playback.why_untracked() == ("first 0", 2)


def test_files(tmp_path, read_ply):
    playback, _ = playback_of(frames(9))
    playback.write(tmp_path, "complete")
    assert read_tum(tmp_path / "camera.tum").positions[:, 0].tolist() == [2.0, 3.0, 4.0, 5.0, 7.0, 8.0]
    assert np.allclose(read_tum(tmp_path / "camera_final.tum").positions[:, 0], [2.0, 3.1, 4.1, 5.1, 7.2, 8.2])
    assert np.allclose(read_tum(tmp_path / "keyframes.tum").positions[:, 0], [0.0, 3.1, 6.2])
    vertices = read_ply(tmp_path / "map.ply")
    points = zip(*(vertices[name] for name in ("segment", "keyframe_id", "x", "z", "red")))
    x = [float(np.float32(3.1 * keyframe)) for keyframe in range(3)]
    assert sorted(points) == [
        (0, 0, x[0], 5.0, 40),
        (0, 1, x[1], 2.0, 40),
        *3 * [(0, 1, x[1], 5.0, 40)],
        (1, 2, x[2], 2.0, 40),
        *2 * [(1, 2, x[2], 5.0, 40)],
    ]
    header, *rows = (tmp_path / "timing.csv").read_text().splitlines()
    assert header == "stamp,total_ms,undistort_ms,track_ms,is_keyframe,state"
    assert [row.split(",")[-1] for row in rows][5:8] == ["tracking", "lost", "tracking"]
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["end"], summary["frames"]) == ("complete", 9)


def test_what_was_computed_before_a_failure_can_be_written(tmp_path):
    def breaking():
        yield from frames(5)
        raise OSError("gone")

    playback = Playback(VisualRun(lambda image: image, FakeOdometry()), WarningLog(print))
    with pytest.raises(OSError, match="gone"):
        playback.play(breaking())
    playback.write(tmp_path, "failed: gone")
    assert len(read_tum(tmp_path / "camera.tum")) == 3
    assert json.loads((tmp_path / "summary.json").read_text())["end"] == "failed: gone"


def test_a_run_without_any_frame_still_writes_its_files(tmp_path, read_ply):
    Playback(VisualRun(lambda image: image, FakeOdometry()), WarningLog(print)).write(tmp_path, "interrupted")
    assert (tmp_path / "camera.tum").read_text() == ""
    assert read_ply(tmp_path / "map.ply")["x"] == []
    assert json.loads((tmp_path / "summary.json").read_text())["ms"]["all"]["mean"] is None
