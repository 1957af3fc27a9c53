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
from ceiling_dso_ros.dso.start.first_map_check import FirstMapCheck
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
        mapper = Mapper(CAMERA, CONFIG, self.pool, self.selector, segment=0, first_id=0)
        pixels = self.selector.select(self.first.image_slot, 500)
        idepth = surface.idepth(np.eye(4), pixels.u, pixels.v).astype(np.float32)
        mapper.begin(self.first, FirstMap(MOTION, pixels, idepth, 0.0, 0.0))
        mapper.trace(self.newest)
        self.map = mapper.add_keyframe(self.newest, StageTimer())

    @staticmethod
    def _noisy(image, noise, rng):
        return (image + rng.normal(0.0, noise, image.shape)).astype(np.float32)

    def fault(self, first=None, newest=None, **limits):
        config = replace(CONFIG, initialization=replace(CONFIG.initialization, **limits))
        check = FirstMapCheck(config, FrameTracker(self.pool, config.tracking), self.selector)
        return check.fault(self.map, first or self.first, newest or self.newest)


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
