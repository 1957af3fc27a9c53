# SPDX-License-Identifier: BSD-3-Clause
"""A drive that begins, goes straight on and stops, played with and without leaving images out."""

import numpy as np
import pytest

from ceiling_dso_ros.dso import OdometryConfig, TrackingState
from ceiling_dso_ros.dso.config import WindowConfig
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion.state import FusionState
from ceiling_dso_ros.io.recording import Frame
from ceiling_dso_ros.io.warning_log import WarningLog
from ceiling_dso_ros.playback.frame_regulation import LONGEST_S, SETTLING_S
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.playback import Playback
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

pytestmark = pytest.mark.long
HZ, DRIVE_S = 15.0, 11.0
CONFIG = OdometryConfig(window=WindowConfig(max_keyframes=7, candidate_points=600, active_points=600))


@pytest.fixture(scope="module")
def recording():
    camera = CameraModel(width=424, height=240, fps=HZ)
    return SimulatedRecording(SimulationConfig("stop_and_go", "factory", camera=camera, duration_s=DRIVE_S))


class Decoded:
    """The images, each rendered once for all runs, and how often one was asked for."""

    def __init__(self, recording):
        self._recording, self._frames, self.count = recording, {}, 0

    def frames(self, leaves_out):
        for listed in self._recording.images():
            if not leaves_out(listed.stamp_ns):
                if listed.stamp_ns not in self._frames:
                    self._frames[listed.stamp_ns] = Frame(listed.stamp_ns, listed.exposure_ms, listed.decode())
                self.count += 1
                yield self._frames[listed.stamp_ns]


@pytest.fixture(scope="module")
def images(recording):
    return Decoded(recording)


def play(recording, images, regulated, predict=True):
    visual = VisualRun.of(recording, CONFIG)
    visual.regulate(regulated)
    fusion = FusionPlayback.of(recording)
    playback = Playback(visual, WarningLog(print), fusion, predict=predict)
    before = images.count
    playback.play(images.frames(playback.leaves_out))
    return playback, fusion, images.count - before


@pytest.fixture(scope="module")
def regulated(recording, images):
    return play(recording, images, regulated=True)


def stamps_ns(playback):
    return playback.visual.trajectories.live().stamps_ns


def test_images_that_are_left_out_are_not_even_read_and_are_counted(regulated, recording):
    playback, _, read = regulated
    summary = playback.summary()
    told = summary["frame_rate"]
    assert told["used"] == read == summary["frames"]
    assert told["used"] + told["left_out"] == len(recording)
    assert sum(told["reasons"].values()) == told["used"]
    assert told["left_out"] > 0.15 * len(recording)  # the first map takes a third of this drive
    assert summary["skipped"] == summary["lost"] == 0


def test_all_images_are_used_while_the_map_is_new_and_later_gaps_are_short(regulated):
    used_ns = stamps_ns(regulated[0])
    gaps_s = seconds(np.diff(used_ns))
    young = seconds(used_ns[1:] - used_ns[0]) < SETTLING_S
    assert gaps_s[young].max() < 1.5 / HZ
    assert gaps_s[~young].max() > 1.5 / HZ
    assert gaps_s.max() <= LONGEST_S + 1.0 / HZ


def test_the_fusion_misses_nothing(regulated, recording):
    """Poses of the wheels come all the time; and a camera whose images are left out is neither silent nor frozen."""
    playback, fusion, _ = regulated
    states = [state for state in fusion.states if state.stamp_ns > stamps_ns(playback)[0]]
    assert len(fusion.states) == len(recording.wheels) - 1
    assert not [reason for state in states for reason in state.reasons if reason.startswith("camera")]
    assert states[-1].state is FusionState.CONVERGED
    assert playback.timing.count(TrackingState.RETRYING) == 0


def test_the_pose_is_as_good_as_with_all_images(regulated, recording, images):
    _, every, read = play(recording, images, regulated=False)
    assert read == len(recording)
    truth = recording.base_truth
    errors_m = []
    for fusion in (regulated[1], every):
        last = fusion.fused()
        moved_m = np.linalg.norm(last.positions[-1, :2] - last.positions[0, :2])
        true_m = np.linalg.norm(truth.positions[-1, :2] - truth.positions[0, :2])
        errors_m.append(abs(moved_m - true_m) / true_m)
    assert errors_m[0] < errors_m[1] + 0.002


def test_the_same_recording_gives_the_same_images_and_poses(regulated, recording, images):
    again, fusion, _ = play(recording, images, regulated=True)
    for first, second in ((regulated[0].visual.trajectories, again.visual.trajectories), (regulated[1], fusion)):
        for name, make in first.files().items():
            assert make().matrices().tobytes() == second.files()[name]().matrices().tobytes(), name


def test_without_the_wheels_prediction_the_gaps_are_shorter(recording, images):
    playback, _, read = play(recording, images, regulated=True, predict=False)
    assert read < len(recording)
    assert seconds(np.diff(stamps_ns(playback))).max() < 0.25
