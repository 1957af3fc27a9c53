# SPDX-License-Identifier: BSD-3-Clause
"""First maps that are to be believed, and the reasons why others are not."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso.compute.stage_timer import StageTimer
from ceiling_dso_ros.dso.config import OdometryConfig, WindowConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.mapping.first_map import FirstMap
from ceiling_dso_ros.dso.mapping.mapper import Mapper
from ceiling_dso_ros.dso.mapping.vignetting import VignetteEstimator
from ceiling_dso_ros.dso.start.first_map_check import FirstMapCheck, image_distance
from ceiling_dso_ros.dso.tracking.frame_tracker import FrameTracker

SURFACE = Surface(slope=(0.1, -0.1), relief=0.08, texture=SHARP)
CONFIG = OdometryConfig(window=WindowConfig(max_keyframes=3, min_keyframes=2, candidate_points=400, active_points=300))
MOTION = se3.exp(np.array([0.03, 0.01, 0.0, 0.0, 0.0, 0.02]))


class TwoFrames:
    """A map of two frames with the true depth, and what is needed to judge it."""

    def __init__(self, contrast=SHARP.contrast, noise=0.0):
        surface = replace(SURFACE, texture=replace(SHARP, contrast=contrast))
        self.pool = PyramidPool(CAMERA, 4)
        self.selector = PixelSelector(self.pool)
        rng = np.random.default_rng(0)
        self.first, self.newest = (
            Frame(k, 1.0, self.pool.build(self._noisy(surface.render(T), noise, rng)), T, np.zeros(2))
            for k, T in enumerate((np.eye(4), MOTION))
        )
        mapper = Mapper(CAMERA, CONFIG, self.pool, self.selector, VignetteEstimator(CAMERA, 5))
        pixels = self.selector.select(self.first.image_slot, 500)
        idepth = surface.idepth(np.eye(4), pixels.u, pixels.v).astype(np.float32)
        mapper.begin(0, self.first, FirstMap(MOTION, pixels, idepth, 0.0, 0.0))
        mapper.trace(self.newest)
        self.map = mapper.add_keyframe(self.newest, StageTimer())

    @staticmethod
    def _noisy(image, noise, rng):
        return (image + rng.normal(0.0, noise, image.shape)).astype(np.float32)

    def fault(self, first=None, newest=None, **limits):
        config = replace(CONFIG, initialization=replace(CONFIG.initialization, **limits))
        check = FirstMapCheck(config, FrameTracker(self.pool, config.tracking), self.selector)
        fault = check.fault(self.map, first or self.first, newest or self.newest)
        return None if fault is None else fault.reason

    def in_a_plane(self, first=None):
        """The same, of a camera that is known to move in a plane."""
        return self.fault(first, replace(self.newest, normal=np.array([0.0, 0.0, 1.0])))


@pytest.fixture(scope="module")
def two_frames():
    return TwoFrames()


def test_a_true_map_is_believed(two_frames):
    assert two_frames.fault() is None


def test_errors_above_the_limit_are_named_with_their_size(two_frames):
    assert f"({two_frames.map.rmse:.1f} grey levels)" in two_frames.fault(max_rmse=0.5 * two_frames.map.rmse)


def test_too_few_points_are_counted(two_frames):
    needed = two_frames.map.active_points / CONFIG.window.active_points
    assert two_frames.fault(min_share=0.99 * needed) is None
    assert f"{two_frames.map.active_points} points only" in two_frames.fault(min_share=1.01 * needed)


def test_texture_that_noise_could_have_made_is_none():
    assert "too little texture" in TwoFrames(contrast=8.0, noise=4.0).fault()


def test_a_first_frame_that_its_own_map_does_not_explain_is_a_fault(two_frames):
    slot = two_frames.pool.build(np.full((CAMERA.height, CAMERA.width), 90, np.uint8))
    try:
        assert "too little texture" in two_frames.fault(first=replace(two_frames.first, image_slot=slot))
    finally:
        two_frames.pool.release(slot)


def test_a_true_map_of_a_camera_that_moves_in_a_plane_is_believed(two_frames):
    assert two_frames.in_a_plane() is None


def test_faint_texture_suffices_in_a_plane_as_long_as_images_are_found_again():
    faint = TwoFrames(contrast=8.0, noise=2.0)
    assert "too little texture" in faint.fault()
    assert faint.in_a_plane() is None


def test_an_image_of_noise_is_not_found_again(two_frames):
    noise = np.random.default_rng(1).normal(120.0, 4.0, (CAMERA.height, CAMERA.width)).astype(np.float32)
    slot = two_frames.pool.build(noise)
    try:
        assert "too little texture" in two_frames.in_a_plane(first=replace(two_frames.first, image_slot=slot))
    finally:
        two_frames.pool.release(slot)


@pytest.mark.parametrize("limits", [{"max_rmse": 0.01}, {"min_share": 0.99}])
def test_a_map_that_is_wrong_is_not_waited_for(two_frames, limits):
    config = replace(CONFIG, initialization=replace(CONFIG.initialization, **limits))
    check = FirstMapCheck(config, FrameTracker(two_frames.pool, config.tracking), two_frames.selector)
    assert not check.fault(two_frames.map, two_frames.first, two_frames.newest).more_parallax_helps


def test_only_in_a_plane_a_doubtful_map_is_waited_for(two_frames):
    noise = np.random.default_rng(1).normal(120.0, 4.0, (CAMERA.height, CAMERA.width)).astype(np.float32)
    slot = two_frames.pool.build(noise)
    first = replace(two_frames.first, image_slot=slot)
    check = FirstMapCheck(CONFIG, FrameTracker(two_frames.pool, CONFIG.tracking), two_frames.selector)
    try:
        assert not check.fault(two_frames.map, first, two_frames.newest).more_parallax_helps
        in_a_plane = replace(two_frames.newest, normal=np.array([0.0, 0.0, 1.0]))
        assert check.fault(two_frames.map, first, in_a_plane).more_parallax_helps
    finally:
        two_frames.pool.release(slot)


def test_image_distance_is_the_shift_of_the_image(two_frames):
    reference = two_frames.map.reference
    tracker = FrameTracker(two_frames.pool, CONFIG.tracking)
    T = se3.inverse(reference.T_camera_world @ two_frames.map.keyframes[0].T_world_camera)
    found = tracker.track(two_frames.first.image_slot, 1.0, reference, [T], np.zeros(2), np.inf)
    assert image_distance(found, found, reference) < 1e-9
    turned = replace(found, T_frame_reference=se3.exp(np.array([0, 0, 0, 0.01, 0, 0])) @ found.T_frame_reference)
    assert image_distance(found, turned, reference) == pytest.approx(0.01 * CAMERA.fy, rel=0.2)
