# SPDX-License-Identifier: BSD-3-Clause
"""Tracking through the pyramid: known motions are found, wrong hypotheses are given up."""

import itertools

import numpy as np
import pytest
from synthetic import CAMERA, Surface

from ceiling_dso_ros.dso import CameraMotion
from ceiling_dso_ros.dso.config import TrackingConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import level_intrinsics
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.tracking import frame_tracker as tracking
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker, motion_hypotheses
from ceiling_dso_ros.dso.tracking.tracking_reference import ReferenceLevel, TrackingReference

SURFACE = Surface(slope=(-0.2, 0.1), relief=0.05)
REFERENCE_AFFINE = (0.1, 4.0)
REFERENCE_EXPOSURE = 1.1


@pytest.fixture
def pool():
    return PyramidPool(CAMERA, 3)


@pytest.fixture
def reference(pool):
    """A keyframe at the origin with true depth at random pixels of each level, grey values from its own image."""
    slot = pool.build(SURFACE.render(np.eye(4), CAMERA, REFERENCE_AFFINE, REFERENCE_EXPOSURE))
    levels = []
    for level, (width, height) in enumerate(pool.shape.sizes):
        rng, n = np.random.default_rng(level), (2000, 1200, 600)[level]
        u, v = rng.integers(2, width - 2, n), rng.integers(2, height - 2, n)
        parameters = level_intrinsics(CAMERA.parameters, level)
        idepth = SURFACE.look(np.eye(4), parameters, u.astype(float), v.astype(float))[1]
        grey = pool.level(slot, level).reshape(height, width)[v, u]
        levels.append(ReferenceLevel(*(a.astype(np.float32) for a in (u, v, idepth, grey))))
    return TrackingReference(
        7, np.eye(4), np.array(REFERENCE_AFFINE), REFERENCE_EXPOSURE, CAMERA.parameters, tuple(levels)
    )


def track(pool, reference, image, hypotheses, exposure=REFERENCE_EXPOSURE, expected_rmse=np.inf, config=None):
    slot = pool.build(image.astype(np.float32))
    tracker = FrameTracker(pool, config or TrackingConfig())
    result = tracker.track(slot, exposure, reference, hypotheses, np.array(REFERENCE_AFFINE), expected_rmse)
    pool.release(slot)
    return result


@pytest.mark.parametrize(
    "motion",
    [
        [0.03, -0.02, 0.01, 0.005, -0.005, 0.01],
        [0.08, 0.0, 0.0, 0.0, 0.0, 0.03],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.06],
        [0.0, 0.0, 0.0, 0.02, -0.02, 0.0],
    ],
)
@pytest.mark.parametrize(("affine", "exposure"), [(REFERENCE_AFFINE, 1.1), ((0.3, -10.0), 1.4)])
def test_a_known_motion_and_brightness_is_found(pool, reference, motion, affine, exposure):
    T = se3.exp(np.array(motion))
    tracked = track(pool, reference, SURFACE.render(T, CAMERA, affine, exposure), [np.eye(4)], exposure)
    assert np.abs(se3.log(tracked.T_frame_reference @ np.linalg.inv(T))).max() < 5e-4
    assert tracked.affine[0] == pytest.approx(affine[0], abs=0.01)
    grey = 120.0
    ours, true = (exposure * np.exp(a) * grey + b for a, b in (tracked.affine, affine))
    assert ours == pytest.approx(true, abs=0.5)
    assert tracked.rmse < 3.0
    assert tracked.saturated < 0.05


def test_flow_and_information_are_those_of_the_result(pool, reference):
    T = se3.exp(np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.1]))
    tracked = track(pool, reference, SURFACE.render(T, CAMERA, REFERENCE_AFFINE, 1.1), [T])
    mean_idepth = np.mean(reference.levels[0].idepth)
    assert np.sqrt(tracked.translation_flow) == pytest.approx(200 * 0.05 * mean_idepth, rel=0.1)
    assert tracked.motion_flow > tracked.translation_flow
    np.testing.assert_allclose(tracked.covariance, tracked.covariance.T, rtol=1e-9)
    sigma = np.sqrt(np.diag(tracked.covariance))
    assert sigma.min() > 1e-6
    assert sigma.max() < 0.05
    assert tracked.weakest > 10


def test_a_hypothesis_far_off_is_given_up_on_the_coarsest_level(pool, reference, monkeypatch):
    T = se3.exp(np.array([0.04, 0.0, 0.0, 0.0, 0.0, 0.02]))
    far = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.25, 1.2])) @ T
    image = SURFACE.render(T, CAMERA, REFERENCE_AFFINE, 1.1)
    widths, align = [], tracking.align
    monkeypatch.setattr(tracking, "align", lambda *args: widths.append(args[5]) or align(*args))
    alone = track(pool, reference, image, [T], expected_rmse=0.0)
    widths.clear()
    tracked = track(pool, reference, image, [T, far], expected_rmse=0.0)  # never good enough to stop trying
    assert widths[:5] == [80, 160, 320, 160, 320]  # the first hypothesis on the finest levels alone, too
    assert set(widths[5:]) == {80}
    np.testing.assert_array_equal(tracked.T_frame_reference, alone.T_frame_reference)


def test_a_later_hypothesis_may_win(pool, reference):
    T = se3.exp(np.array([0.04, 0.0, 0.0, 0.0, 0.0, 0.5]))
    image = SURFACE.render(T, CAMERA, REFERENCE_AFFINE, 1.1)
    tracked = track(pool, reference, image, [np.eye(4), se3.exp(np.array([0, 0, 0, 0, 0, 0.48]))], expected_rmse=3.0)
    assert np.abs(se3.log(tracked.T_frame_reference @ np.linalg.inv(T))).max() < 1e-3


def test_a_right_hypothesis_survives_coarse_levels_that_mislead_it(pool, reference, monkeypatch):
    """As beside a grating, which looks like itself a period further."""
    T = se3.exp(np.array([0.04, 0.0, 0.0, 0.0, 0.0, 0.02]))
    image = SURFACE.render(T, CAMERA, REFERENCE_AFFINE, 1.1)
    away, align = se3.exp(np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])), tracking.align

    def misled(*args):
        T_found, *rest = align(*args)
        return (away @ T_found if args[5] == 80 else T_found, *rest)

    monkeypatch.setattr(tracking, "align", misled)
    tracked = track(pool, reference, image, [T, np.eye(4)], expected_rmse=3.0)
    assert np.abs(se3.log(tracked.T_frame_reference @ np.linalg.inv(T))).max() < 1e-3
    monkeypatch.setattr(FrameTracker, "_attempts", lambda *args: ((T, args[5], 3) for T in args[4]))
    tracked = track(pool, reference, image, [T, np.eye(4)], expected_rmse=3.0)
    assert tracked is None or np.abs(se3.log(tracked.T_frame_reference @ np.linalg.inv(T))).max() > 1e-2


@pytest.mark.parametrize(("affine", "exposure"), [((-1.5, 0.0), 1.1), ((-0.6, 90.0), 1.1), (REFERENCE_AFFINE, 8.0)])
def test_light_that_has_changed_at_once_is_found(pool, reference, affine, exposure):
    """Lamps that went out or on, or an exposure that is wrong by a factor of seven."""
    T = se3.exp(np.array([0.03, -0.02, 0.01, 0.005, -0.005, 0.01]))
    image = SURFACE.render(T, CAMERA, affine, 1.1)
    tracked = track(pool, reference, image, [np.eye(4)], exposure, expected_rmse=3.0)
    assert np.abs(se3.log(tracked.T_frame_reference @ np.linalg.inv(T))).max() < 1e-3
    gain = exposure * np.exp(tracked.affine[0])
    assert gain == pytest.approx(1.1 * np.exp(affine[0]), rel=0.02)
    assert tracked.affine[1] == pytest.approx(affine[1], abs=2.0)


def test_a_good_first_hypothesis_ends_the_search(pool, reference):
    T = se3.exp(np.array([0.04, 0.0, 0.0, 0.0, 0.0, 0.02]))
    hypotheses = iter([T, np.eye(4), np.eye(4)])
    track(pool, reference, SURFACE.render(T, CAMERA, REFERENCE_AFFINE, 1.1), hypotheses, expected_rmse=10.0)
    assert len(list(hypotheses)) == 2


def test_nothing_in_view_is_no_frame(pool, reference):
    away = se3.exp(np.array([0, 0, 0, 0, 2.0, 0]))
    assert track(pool, reference, SURFACE.render(np.eye(4)), [away]) is None
    assert track(pool, reference, SURFACE.render(np.eye(4)), []) is None


def test_impossible_brightness_is_no_frame(pool, reference):
    image = SURFACE.render(np.eye(4), CAMERA, (REFERENCE_AFFINE[0] - 2.5, 4.0), 1.1)
    assert track(pool, reference, image, [np.eye(4)]) is None


def test_hypotheses():
    T_last, T_step = se3.exp(np.array([0.1, 0.0, 0.02, 0, 0, 0.1])), se3.exp(np.array([0.03, 0.01, 0, 0, 0, 0.05]))
    T_other = se3.exp(np.array([0.3, -0.1, 0.0, 0.0, 0.02, 0.1]))
    hypotheses = list(motion_hypotheses(T_last, T_step))
    half = se3.exp(0.5 * se3.log(T_step))
    for ours, expected in zip(
        hypotheses, (T_step @ T_last, T_step @ T_step @ T_last, half @ T_last, T_last, np.eye(4))
    ):
        np.testing.assert_allclose(ours, expected, atol=1e-12)
    certain = CameraMotion(np.linalg.inv(T_other), np.zeros((6, 6)))
    predicted = list(motion_hypotheses(T_last, T_step, certain))
    np.testing.assert_allclose(predicted[0], T_other @ T_last, atol=1e-12)
    np.testing.assert_array_equal(predicted[1:], hypotheses)
    unsure = CameraMotion(np.linalg.inv(T_other), np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.1**2]))
    predicted = list(motion_hypotheses(T_last, T_step, unsure))
    np.testing.assert_array_equal(predicted[1], hypotheses[0])
    expected = [se3.inverse(T_last_frame) @ T_last for T_last_frame in unsure.alternatives()]
    np.testing.assert_array_equal(predicted[2:4], expected)
    np.testing.assert_array_equal(predicted[4:], hypotheses[1:])
    turned = hypotheses[5:]
    assert len(turned) == 26
    angles = np.array([se3.log(T @ np.linalg.inv(T_step @ T_last))[3:] for T in turned])
    assert set(map(tuple, np.sign(np.round(angles, 9)))) == set(itertools.product((0, 1, -1), repeat=3)) - {(0, 0, 0)}
    assert 0.005 < np.abs(angles).max() < 0.1


def test_a_prediction_wrong_by_no_more_than_it_says_leads_to_the_frame(pool, reference):
    T, predicted = (se3.exp(np.array([0.04, 0.0, 0.0, 0.0, 0.0, yaw])) for yaw in (0.5, 0.9))
    image = SURFACE.render(T, CAMERA, REFERENCE_AFFINE, 1.1)

    def track_with(sigma):
        prediction = CameraMotion(np.linalg.inv(predicted), np.diag([0.0, 0.0, 0.0, 0.0, 0.0, sigma**2]))
        return track(pool, reference, image, motion_hypotheses(np.eye(4), np.eye(4), prediction), expected_rmse=3.0)

    found = track_with(sigma=0.2)
    assert np.abs(se3.log(found.T_frame_reference @ np.linalg.inv(T))).max() < 1e-3
    too_sure = track_with(sigma=0.0)
    assert too_sure is None or np.abs(se3.log(too_sure.T_frame_reference @ np.linalg.inv(T))).max() > 0.1
