# SPDX-License-Identifier: BSD-3-Clause
"""The first map of a synthetic scene: motion, depth and brightness; the ambiguity of a plane."""

import numpy as np
import pytest
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso.config import InitializationConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.start import initializer as initialization
from ceiling_dso_ros.dso.start.initializer import Initializer, dual_motion

RELIEF = Surface(slope=(0.1, -0.1), relief=0.15, texture=SHARP)


@pytest.mark.parametrize(
    ("translation", "plane"),
    [([0.03, -0.02, 0.02], [0.2, -0.1, 1.0]), ([0.01, 0.02, -0.03], [-0.3, 0.2, 0.8]), ([0.02, 0.0, 0.05], [0, 0, 1])],
)
def test_both_motions_give_the_same_homography(translation, plane):
    """R + t n^T of both, to first order: the error is of second order when the motion shrinks."""
    errors = []
    for size in (1.0, 0.1):
        T = se3.exp(np.array([0, 0, 0, 0.02, -0.01, 0.03]) * size)
        T[:3, 3] = size * np.array(translation)
        T_dual, plane_dual = dual_motion(T, np.array(plane, float))
        homographies = [M[:3, :3] + np.outer(M[:3, 3], n) for M, n in ((T, plane), (T_dual, plane_dual))]
        errors.append(np.abs(homographies[0] - homographies[1]).max())
        difference = np.abs(T_dual[:3, 3] - T[:3, 3]).max() if plane[:2] != [0, 0] else 1.0
        np.testing.assert_allclose(T_dual[:3, :3] @ T_dual[:3, :3].T, np.eye(3), atol=1e-12)
        assert plane_dual[2] == pytest.approx(plane[2])  # the same inverse depth straight ahead
        assert difference > 1e-3 * size
    assert errors[0] < 0.1 * np.linalg.norm(translation)
    assert errors[1] < 0.02 * errors[0]


def test_the_dual_of_the_dual_is_the_motion():
    T = se3.exp(np.array([0.03, -0.02, 0.02, 0.001, 0.002, -0.001]) * 0.01)
    plane = np.array([0.2, -0.1, 1.0])
    T_back, plane_back = dual_motion(*dual_motion(T, plane))
    np.testing.assert_allclose(plane_back, plane, atol=1e-9)
    np.testing.assert_allclose(T_back[:3, 3], T[:3, 3], atol=1e-12)
    np.testing.assert_allclose(T_back, T, atol=1e-6)


def test_sideways_motion_has_no_dual_in_front_of_the_camera():
    assert dual_motion(se3.exp(np.array([0.05, 0.02, 0.0, 0, 0, 0])), np.array([0.1, 0.0, 1.0])) is None


class Session:
    """An initialiser fed with images from poses."""

    def __init__(self, surface, config=None):
        self.surface = surface
        self.pool = PyramidPool(CAMERA, 3)
        self.initializer = Initializer(self.pool, CAMERA.parameters, config or InitializationConfig())

    def start(self, T=None, affine=(0.0, 0.0)):
        slot = self.pool.build(self.surface.render(np.eye(4) if T is None else T, affine=affine))
        self.initializer.start(slot, PixelSelector(self.pool))

    def add(self, T, affine=(0.0, 0.0), exposure=1.0, prediction=None):
        slot = self.pool.build(self.surface.render(T, affine=affine, exposure=exposure))
        result = self.initializer.add(slot, exposure, prediction)
        self.pool.release(slot)
        return result


def fly(direction, frames=15, **light):
    """Feed a straight motion; returns the first map and the true motion to its frame."""
    session = Session(RELIEF)
    session.start()
    for k in range(1, frames + 1):
        T = se3.exp(k * np.array(direction))
        first_map = session.add(T, **light)
        if first_map is not None:
            return first_map, T
    return None, None


@pytest.mark.parametrize(
    "direction",
    [
        [0.01, 0.004, 0.0, 0.0, 0.0, 0.0],
        [-0.008, 0.008, 0.002, 0.001, -0.001, 0.008],
        [0.01, 0.0, 0.004, 0.0, 0.0, -0.005],
    ],
)
def test_motion_and_depth_of_a_relief(direction):
    first_map, T = fly(direction)
    assert first_map is not None
    true = RELIEF.idepth(np.eye(4), first_map.pixels.u, first_map.pixels.v)
    assert first_map.idepth.size > 500
    assert first_map.idepth.mean() == pytest.approx(1.0, abs=1e-3)
    scale = np.median(true / first_map.idepth)  # their unit of length in ours, inverted
    assert np.median(np.abs(first_map.idepth * scale / true - 1)) < 0.02
    assert np.corrcoef(first_map.idepth, true)[0, 1] > 0.9
    ours = first_map.T_frame_first
    error = np.linalg.norm(ours[:3, 3] / scale - T[:3, 3]) / np.linalg.norm(T[:3, 3])
    assert error < 0.1
    assert np.abs(se3.log_so3(ours[:3, :3] @ T[:3, :3].T)).max() < 8e-3


def test_brightness_is_found():
    first_map, _ = fly([0.01, 0.004, 0.0, 0.0, 0.0, 0.0], affine=(0.08, -4.0), exposure=1.1)
    ours = np.exp(first_map.log_gain) * 120 + first_map.offset
    assert ours == pytest.approx(1.1 * np.exp(0.08) * 120 - 4.0, abs=1.0)


@pytest.mark.filterwarnings("error")
def test_wheels_that_are_stuck_do_not_keep_the_camera_from_its_map():
    """They predict that the camera stands."""
    first_map, T = fly(
        [0.01, 0.004, 0.0, 0.0, 0.0, 0.0], prediction=CameraMotion(np.eye(4), 1e-6 * np.eye(6), metric=True)
    )
    assert first_map is not None
    found = first_map.T_frame_first[:3, 3]
    assert found @ T[:3, 3] > 0.99 * np.linalg.norm(found) * np.linalg.norm(T[:3, 3])


def test_few_images_a_second_need_few_frames():
    """A start from rest at 3 images a second: motion between images grows beyond what alignment reaches from zero."""
    session = Session(RELIEF)
    session.start()
    shifts = np.cumsum([0.01, 0.03, 0.05, 0.06, 0.07])
    for shift in shifts:
        T = se3.exp(np.array([shift, 0.4 * shift, 0.0, 0.0, 0.0, 0.5 * shift]))
        first_map = session.add(T)
        if first_map is not None:
            break
    assert first_map is not None
    assert shift < shifts[-1]
    true = RELIEF.idepth(np.eye(4), first_map.pixels.u, first_map.pixels.v)
    scale = np.median(true / first_map.idepth)
    assert np.median(np.abs(first_map.idepth * scale / true - 1)) < 0.03


def test_no_map_without_parallax():
    session = Session(RELIEF)
    assert not session.initializer.started
    session.start()
    assert session.initializer.started
    for k in range(8):
        assert session.add(se3.exp(k * np.array([0, 0, 0, 0, 0, 0.02]))) is None


def test_depths_that_run_away_are_flattened_and_found_later(monkeypatch):
    """On faint planes the first alignment with free depths may end far off, with a much larger error."""
    session = Session(RELIEF)
    session.start()
    align, ran_away = Initializer._align, []

    def run_away_once(self, image_slot, T, light):
        align(self, image_slot, T, light)
        if self._snapped and not ran_away:
            ran_away.append(self.rmse)
            self._T = se3.exp(np.array([0.5, 0.0, 0.0, 0.0, 0.3, 0.0])) @ self._T
            self._levels[0].points.idepth[:] = 9.0
            self.rmse *= 100.0

    monkeypatch.setattr(Initializer, "_align", run_away_once)
    for k in range(1, 20):
        T = se3.exp(k * np.array([0.01, 0.004, 0.0, 0.0, 0.0, 0.0]))
        already = bool(ran_away)
        first_map = session.add(T)
        if ran_away and not already:
            assert session.initializer.rmse < 20 * ran_away[0]  # that of a plane before a relief
            assert np.linalg.norm(session.initializer._T[:3, 3]) < 0.2
        if first_map is not None:
            break
    assert ran_away
    true = RELIEF.idepth(np.eye(4), first_map.pixels.u, first_map.pixels.v)
    scale = np.median(true / first_map.idepth)
    assert np.median(np.abs(first_map.idepth * scale / true - 1)) < 0.02


def test_a_dual_plane_that_cuts_the_view_of_one_level_leaves_all_levels_as_they_are(monkeypatch):
    asked = []

    def plane_idepth(self, index, plane):
        asked.append(index)
        return np.full(self._levels[index].count, -1.0 if index else 1.0, np.float32)

    monkeypatch.setattr(Initializer, "_plane_idepth", plane_idepth)
    first_map, _ = fly([0.01, 0.0, 0.004, 0.0, 0.0, -0.005])
    assert set(asked) >= {0, 1}
    true = RELIEF.idepth(np.eye(4), first_map.pixels.u, first_map.pixels.v)
    scale = np.median(true / first_map.idepth)
    assert np.median(np.abs(first_map.idepth * scale / true - 1)) < 0.02


def test_a_first_frame_that_was_covered_in_part_leads_to_no_map():
    """A third of its points are on something that is gone: they pull the motion, and fit nowhere all the same."""
    session = Session(RELIEF)
    elsewhere = RELIEF.render(se3.exp(np.array([0.5, 0.4, 0.0, 0.0, 0.0, 0.0])))
    first = RELIEF.render(np.eye(4))
    first[:, :120] = elsewhere[:, :120]
    session.initializer.start(session.pool.build(first), PixelSelector(session.pool))
    for k in range(1, 12):
        assert session.add(se3.exp(k * np.array([0.01, 0.004, 0.0, 0.0, 0.0, 0.0]))) is None
        if session.initializer.failed:
            break
    assert session.initializer.failed


def covered(image, share):
    """An image with the left part of the lens covered."""
    return np.where(np.arange(CAMERA.width) < share * CAMERA.width, np.float32(2.0), image)


@pytest.mark.parametrize("waits", [0, 3])
@pytest.mark.parametrize(("share", "failed"), [(0.4, True), (0.3, True), (0.05, False)])
def test_a_first_frame_that_saw_less_is_not_kept(share, failed, waits):
    """As when a cover slides off the lens: a narrow view cannot tell turns from ways, and the edge moves by itself."""
    session = Session(RELIEF)
    first = covered(RELIEF.render(np.eye(4)), share)
    session.initializer.start(session.pool.build(first), PixelSelector(session.pool))
    for _ in range(waits):
        slot = session.pool.build(first)
        assert session.initializer.add(slot, 1.0) is None
        assert not session.initializer.failed
        session.pool.release(slot)
    session.add(se3.exp(np.array([0.01, 0.004, 0.0, 0.0, 0.0, 0.0])))
    assert session.initializer.failed == failed


def test_the_frame_after_the_first_may_show_hardly_more(monkeypatch):
    """Later ones may: a camera that moves comes to see other things."""
    shares = iter([0.8, 0.83, 0.8, 0.81, 0.83, 0.85, 0.95])
    monkeypatch.setattr(initialization, "textured_share", lambda *_: next(shares))
    session = Session(RELIEF)
    session.start()
    session.add(np.eye(4))
    assert session.initializer.failed
    session.start()
    for failed in (False, False, False, True):
        session.add(np.eye(4))
        assert session.initializer.failed == failed


def test_frames_without_texture_give_no_map_and_no_error():
    session = Session(RELIEF)
    session.start()
    for value in (0.0, 255.0, np.nan, np.inf):
        slot = session.pool.build(np.full((240, 320), value, np.float32))
        session.initializer.add(slot, 1.0)
        session.pool.release(slot)
