# SPDX-License-Identifier: BSD-3-Clause
"""What the mapper does with frames and keyframes of a known scene."""

import numpy as np
import pytest
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.config import OdometryConfig, WindowConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.hosted_points import HostedPoints
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.first_map import FirstMap
from ceiling_dso_ros.dso.mapping.keyframe_policy import PointFate
from ceiling_dso_ros.dso.mapping.mapper import Mapper
from ceiling_dso_ros.dso.mapping.vignetting import VignetteEstimator
from ceiling_dso_ros.dso.status import TrackingLostError
from ceiling_dso_ros.dso.window import trace_outcome
from ceiling_dso_ros.dso.window.candidates import UNSEARCHED_QUALITY

SURFACE = Surface(slope=(0.1, -0.1), relief=0.08, texture=SHARP)
CONFIG = OdometryConfig(window=WindowConfig(max_keyframes=3, min_keyframes=2, candidate_points=400, active_points=300))
STEP = np.array([0.03, 0.01, 0.0, 0.0, 0.0, 0.02])
SEGMENT = 4


class Scene:
    """A mapper that gets every frame with its true pose."""

    def __init__(self):
        self.pool = PyramidPool(CAMERA, 8)
        self.selector = PixelSelector(self.pool)
        self.mapper = Mapper(CAMERA, CONFIG, self.pool, self.selector, VignetteEstimator(CAMERA, 5))
        self.begin(SEGMENT)

    def begin(self, segment):
        self.pool.release_all()
        self.selector.cell = 3  # otherwise that of the image before
        first = self.frame(0)
        pixels = self.selector.select(first.image_slot, 500)
        idepth = SURFACE.idepth(np.eye(4), pixels.u, pixels.v).astype(np.float32)
        self.mapper.begin(segment, first, FirstMap(np.eye(4), pixels, idepth, 0.0, 0.0))

    def frame(self, k, image=None):
        T = se3.exp(k * STEP)
        slot = self.pool.build(SURFACE.render(T) if image is None else image)
        return Frame(100_000_000 * k, 1.0, slot, T, np.zeros(2))

    def keyframe(self, k, image=None):
        frame = self.frame(k, image)
        self.mapper.trace(frame)
        return self.mapper.add_keyframe(frame, StageTimer())


@pytest.fixture
def scene():
    return Scene()


def test_the_first_map_becomes_points_of_the_first_keyframe(scene):
    window = scene.mapper.window
    assert window.ids == [0]
    assert scene.mapper.next_id == 1
    n = window.points.count
    assert n == CONFIG.window.active_points
    a = window.points.arrays
    np.testing.assert_allclose(a.idepth[:n], SURFACE.idepth(np.eye(4), a.u[:n], a.v[:n]), rtol=1e-5)
    image = SURFACE.render(np.eye(4))
    np.testing.assert_array_equal(a.grey[4, :n], image[a.v[:n].astype(int), a.u[:n].astype(int)])
    assert not window.points.residuals.live.any()
    assert (np.diag(window.prior.H) > 0).all()  # intrinsics and the first keyframe are held


def test_keyframes_keep_to_the_truth_and_to_the_size_of_the_window(scene):
    seen = []
    for k in range(1, 8):
        snapshot = scene.keyframe(k)
        reference, estimates = snapshot.reference, snapshot.keyframes
        window = scene.mapper.window
        assert reference.keyframe_id == k
        assert {e.segment for e in estimates} == {SEGMENT}
        assert estimates[-1].keyframe_id == k
        assert window.count <= CONFIG.window.max_keyframes
        assert window.prior.b.size == 4 + 8 * window.count
        assert window.ids == [e.keyframe_id for e in estimates if not e.leaves]
        seen += [e.keyframe_id for e in estimates if e.leaves]
        assert snapshot.rmse < 5
        assert snapshot.stamp_ns == 100_000_000 * k
        assert (snapshot.active_points, snapshot.candidate_points) == (window.points.count, window.candidates.count)
        T = se3.exp(k * STEP)
        error = se3.log(reference.T_camera_world @ np.linalg.inv(T))
        assert np.abs(error).max() < 3e-3
    assert len(seen) == len(set(seen)) >= 4
    n, a = window.points.count, window.points.arrays
    assert n > 100
    true = np.array([SURFACE.idepth(se3.exp(window.ids[a.host[i]] * STEP), a.u[i], a.v[i]) for i in range(n)])
    assert np.median(np.abs(a.idepth[:n] / true - 1)) < 0.01
    assert np.bincount(a.host[:n], minlength=3)[1] > 0  # not only those of the start


def test_frames_narrow_the_candidates(scene):
    scene.keyframe(1)
    candidates = scene.mapper.window.candidates
    a, n = candidates.arrays, candidates.count
    true = SURFACE.idepth(se3.exp(STEP), a.u[:n], a.v[:n])
    before = a.idepth_max[:n] - a.idepth_min[:n]
    assert ((a.idepth_min[:n] < 0.5 * true) & (a.idepth_max[:n] > 2 * true)).all()  # well around the scene so far
    for k in (2, 3, 4):
        scene.mapper.trace(scene.frame(k))
    traced = np.isin(
        a.outcome[:n], (trace_outcome.GOOD, trace_outcome.SKIPPED, trace_outcome.BAD_CONDITION)
    ) & np.isfinite(a.idepth_max[:n])
    traced &= a.quality[:n] < UNSEARCHED_QUALITY
    assert traced.mean() > 0.5
    assert np.median((a.idepth_max[:n] - a.idepth_min[:n])[traced] / before[traced]) < 0.2
    inside = (a.idepth_min[:n] <= true) & (true <= a.idepth_max[:n])
    assert inside[traced].mean() > 0.9


def test_poses_are_found_by_the_identity_of_their_keyframe(scene):
    for k in range(1, 6):
        snapshot = scene.keyframe(k)
    window = scene.mapper.window
    for slot, number in enumerate(window.ids):
        np.testing.assert_array_equal(scene.mapper.pose_of(number), window.keyframes.T_camera_world[slot])
        np.testing.assert_array_equal(snapshot.pose_of(number), window.T_world_camera(slot))


def test_a_snapshot_stays_as_it_is(scene):
    snapshot = scene.keyframe(1)
    before = snapshot.points.positions.copy(), snapshot.pose_of(1).copy()
    scene.keyframe(2)
    np.testing.assert_array_equal(snapshot.points.positions, before[0])
    np.testing.assert_array_equal(snapshot.pose_of(1), before[1])


def test_a_keyframe_that_shows_nothing_loses_the_window(scene):
    scene.keyframe(1)
    with pytest.raises(TrackingLostError):
        scene.keyframe(2, image=np.full((240, 320), 100, np.float32))


def test_points_that_leave_lie_on_the_surface(scene):
    left = HostedPoints.concatenated([scene.keyframe(k).marginalized for k in range(1, 8)])
    assert len(left) > 300
    assert len(set(left.keyframe_id.tolist())) >= 3
    x, y, z = left.positions_world({k: np.linalg.inv(se3.exp(k * STEP)) for k in range(8)}).T
    true = SURFACE.idepth(np.eye(4), CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy)
    assert np.median(np.abs(true * z - 1)) < 0.01
    image = SURFACE.render(np.eye(4))
    u, v = (np.rint(f * a / z + c).astype(int) for f, a, c in ((CAMERA.fx, x, CAMERA.cx), (CAMERA.fy, y, CAMERA.cy)))
    inside = (u >= 0) & (u < CAMERA.width) & (v >= 0) & (v < CAMERA.height)
    assert np.corrcoef(left.grey[inside], image[v[inside], u[inside]])[0, 1] > 0.95


def test_what_the_map_held_is_marginalized_or_still_active_unless_it_was_dropped(scene, monkeypatch):
    expected = []
    retire = Mapper._retire_points

    def watched(mapper, leaving):
        window = mapper.window
        drop = PointFate(window, leaving, CONFIG.optimization).drop
        expected.append((window.hosted_points(~drop), int(drop.sum()), [window.ids[slot] for slot in leaving]))
        return retire(mapper, leaving)

    def rows(points):
        return sorted(zip(points.keyframe_id.tolist(), *points.position_camera.T, points.grey))

    monkeypatch.setattr(Mapper, "_retire_points", watched)
    for k in range(1, 8):
        snapshot = scene.keyframe(k)
        held, _, leaving = expected[-1]
        assert rows(HostedPoints.concatenated([snapshot.marginalized, snapshot.window_points])) == rows(held)
        assert len(snapshot.window_points) == scene.mapper.window.points.count
        assert not set(snapshot.window_points.keyframe_id.tolist()) & set(leaving)
    assert sum(dropped for _, dropped, _ in expected) > 0


def test_a_new_segment_knows_nothing_of_the_one_before():
    scene, fresh = Scene(), Scene()
    for k in range(1, 8):
        scene.keyframe(k)
    ids = scene.mapper.next_id
    scene.mapper.window.points.residuals.energy[:] = 1e9  # of residuals that are outside, it is used as it was
    scene.begin(SEGMENT + 1)
    assert not scene.mapper.window.points.residuals.energy.any()
    for k in range(1, 8):
        again, expected = scene.keyframe(k), fresh.keyframe(k)
        assert again.reference.keyframe_id == ids + expected.reference.keyframe_id
        assert {e.segment for e in again.keyframes} == {SEGMENT + 1}
        for a, b in zip(again.keyframes, expected.keyframes):
            np.testing.assert_array_equal(a.T_world_camera, b.T_world_camera)
        np.testing.assert_array_equal(again.window_points.position_camera, expected.window_points.position_camera)
        np.testing.assert_array_equal(again.marginalized.position_camera, expected.marginalized.position_camera)
        np.testing.assert_array_equal(again.reference.levels[0].idepth, expected.reference.levels[0].idepth)
