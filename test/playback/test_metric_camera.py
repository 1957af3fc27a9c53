# SPDX-License-Identifier: BSD-3-Clause
import json

import numpy as np
import pytest

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, ScaleMeasurement, TrackingState
from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Frame, SecondCamera
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.io.warning_log import WarningLog
from ceiling_dso_ros.playback.metric_camera import metric_camera, scale_summary
from ceiling_dso_ros.playback.playback import METRIC, Playback
from ceiling_dso_ros.playback.right_images import RightImages
from ceiling_dso_ros.playback.trajectory_recorder import TrajectoryRecorder
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.simulation.camera import CameraModel

UNIT_M = 4.0


def moved(x):
    T = np.eye(4)
    T[0, 3] = x
    return T


def status(index, segment=0, unit_m=UNIT_M):
    """A keyframe a second, a tenth of a metre apart, whose second camera tells the unit, or nothing if it is None."""
    T = moved(0.1 * index / (unit_m or 1.0))
    told = {}
    if unit_m is not None:
        told = {"scale": ScaleMeasurement(np.log(unit_m), 0.002, 0.001)}
    keyframe = KeyframeEstimate(index, index * 10**9, segment, T, (0.0, 0.0), False, **told)
    return OdometryStatus(index * 10**9, TrackingState.TRACKING, segment, T, None, True, index, np.eye(4), (keyframe,))


def recorded(*statuses):
    recorder = TrajectoryRecorder()
    for each in statuses:
        recorder.add(each)
    return recorder


def test_the_path_is_in_metres():
    trajectory = metric_camera(recorded(*(status(k) for k in range(20))))
    np.testing.assert_allclose(trajectory.matrices()[:, 0, 3], 0.1 * np.arange(20), atol=1e-9)
    summary = scale_summary(recorded(*(status(k) for k in range(20))))
    assert summary["value"] == pytest.approx(UNIT_M)
    assert 0.001 < summary["sigma"] < 0.002
    assert summary["converged"]


def test_what_has_no_scale_is_left_out():
    recorder = recorded(*(status(k) for k in range(5)), *(status(k, 1, None) for k in range(5, 9)))
    assert metric_camera(recorder).stamps_ns.tolist() == [k * 10**9 for k in range(5)]
    none = recorded(status(0, 0, None))
    assert len(metric_camera(none)) == 0
    assert scale_summary(none) == {"value": None, "sigma": None, "converged": False}


class TwoCameras:
    """An odometry that is told the right image of every frame."""

    def __init__(self):
        self.rights = []

    def skip(self, stamp_ns, _reason):
        return status(stamp_ns // 10**9)

    def track(self, image, stamp_ns, exposure_ms, prediction=None, right=None):
        self.rights.append(None if right is None else right())
        return status(stamp_ns // 10**9)


@pytest.fixture
def visual():
    model = CameraModel(width=96, height=64)
    calibration = CameraCalibration(model.lens, model.pinhole)
    second = SecondCamera(calibration, PhotometricCalibration.linear(), moved(0.095))
    return VisualRun(ImagePreprocessor(calibration), TwoCameras(), right=RightImages(second, None, None))


def frames(count, right):
    for index in range(count):
        image = np.random.default_rng(index).integers(0, 255, (64, 96)).astype(np.uint8)
        yield Frame(index * 10**9, None, image, None if right is None else lambda image=image: right(image))


def test_a_run_without_wheels_writes_it(visual, tmp_path):
    playback = Playback(visual, WarningLog(lambda _: None))
    playback.play(frames(6, lambda image: image))
    playback.write(tmp_path, "complete")
    assert METRIC in playback.files
    written = read_tum(tmp_path / METRIC)
    np.testing.assert_allclose(written.matrices()[:, 0, 3], 0.1 * np.arange(6), atol=1e-8)
    assert json.loads((tmp_path / "summary.json").read_text())["scale"]["value"] == pytest.approx(UNIT_M)


@pytest.mark.parametrize("right", [lambda image: image[:10], None])
def test_right_images_that_cannot_be_used_are_as_good_as_none(visual, right):
    playback = Playback(visual, WarningLog(lambda _: None))
    playback.play(frames(2, right))
    assert visual.odometry.rights == [None, None]
