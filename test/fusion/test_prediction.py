# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.durations import nanoseconds
from ceiling_dso_ros.fusion import planar, prediction
from ceiling_dso_ros.fusion.config import WheelConfig
from ceiling_dso_ros.fusion.graph import GraphEstimate
from ceiling_dso_ros.fusion.prediction import predict_camera_motion
from ceiling_dso_ros.fusion.wheel_motion import WheelNoise, WheelStep
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

NOISE = WheelNoise(WheelConfig(), 0.5, 1e-4)
SCALE, RATE = 4.0, np.array([0.9, 0.0, 0.6])
CONSTANTS = np.diag([0.01, 0.01]) ** 2


def mount():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [-88.0, -1.0, 1.5], degrees=True).as_matrix()
    T[:3, 3] = 0.18, 0.04, 0.62
    return T


def track(seconds=2.0):
    result = WheelTrack(NOISE)
    for index in range(int(seconds * 50)):
        result.add(WheelStep(index * 20_000_000, (index + 1) * 20_000_000, RATE / 50))
    return result


def predict(start_s, end_s, sigma=0.002, constants=(0.0, 0.0)):
    estimate = GraphEstimate(0, np.zeros(3), np.eye(3), np.log(SCALE), sigma, np.array(constants), CONSTANTS)
    span_ns = nanoseconds(start_s), nanoseconds(end_s)
    return predict_camera_motion(track(), NOISE, mount(), estimate, *span_ns)


def expected(seconds, rate=RATE):
    T = np.linalg.inv(mount()) @ planar.lift(planar.expmap(rate * seconds)) @ mount()
    T[:3, 3] /= SCALE
    return T


def test_it_is_the_wheels_motion_in_the_cameras_frame_and_unit():
    np.testing.assert_allclose(predict(1.013, 1.346).T_start_end, expected(0.333), atol=1e-9)


def test_beyond_the_newest_sample_the_wheels_go_on():
    np.testing.assert_allclose(predict(1.98, 2.08).T_start_end, expected(0.1), atol=1e-9)
    np.testing.assert_allclose(predict(2.01, 2.04).T_start_end, expected(0.03), atol=1e-9)


def test_what_the_graph_knows_of_the_wheels_is_used():
    turning = RATE + np.array([0.25 * 0.5 * RATE[2] * 0.02, 0.0, RATE[0] / 0.5 * 0.02])
    np.testing.assert_allclose(predict(1.0, 1.2, constants=(0.02, 0.0)).T_start_end, expected(0.2, turning), atol=1e-4)


def test_covariance_is_that_of_random_wheels(monkeypatch):
    monkeypatch.setattr(prediction, "WOBBLE_RAD", 1e-6)
    monkeypatch.setattr(prediction, "WOBBLE_M", 1e-6)
    rng, T = np.random.default_rng(0), predict(1.0, 1.3)
    step = WheelStep(0, 20_000_000, RATE / 50)
    root = np.linalg.cholesky(NOISE.white(step) + 1e-18 * np.eye(3))
    errors = []
    for _ in range(3000):
        by_constants = NOISE.sensitivity(step.twist)[:, 1:] @ (0.01 * rng.normal(size=2))
        pose = np.zeros(3)
        for noise in rng.normal(size=(15, 3)):
            pose = planar.compose(pose, planar.expmap(step.twist + by_constants + root @ noise))
        camera = np.linalg.inv(mount()) @ planar.lift(pose) @ mount()
        camera[:3, 3] /= SCALE * np.exp(0.002 * rng.normal())
        change = camera @ np.linalg.inv(T.T_start_end)
        errors.append([*change[:3, 3], *Rotation.from_matrix(change[:3, :3]).as_rotvec()])
    sigma = np.sqrt(np.diag(T.covariance))
    scatter = np.std(errors, axis=0)
    np.testing.assert_allclose(sigma[[0, 1, 5]], scatter[[0, 1, 5]], rtol=0.05)
    assert (np.linalg.eigvalsh(T.covariance) > 0).all()


def test_an_unknown_scale_leaves_the_translation_open():
    assert predict(1.0, 1.2, sigma=0.5).covariance[:3, :3].max() > 100 * predict(1.0, 1.2).covariance[:3, :3].max()
    assert predict(1.0, 1.2, sigma=0.5).covariance[5, 5] == pytest.approx(predict(1.0, 1.2).covariance[5, 5])
