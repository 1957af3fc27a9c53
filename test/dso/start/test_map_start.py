# SPDX-License-Identifier: BSD-3-Clause
"""Collecting the first frames of a segment: what is kept of them, and when another first one is taken."""

import numpy as np
import pytest
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso.config import InitializationConfig
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera_motion import CameraMotion
from ceiling_dso_ros.dso.images.frame import Frame
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector
from ceiling_dso_ros.dso.start.map_start import MORE_PARALLAX, MapStart

SURFACE = Surface(slope=(0.1, -0.1), relief=0.15, texture=SHARP)
STEP = np.array([0.01, 0.004, 0.0, 0.0, 0.0, 0.002])
START = se3.exp(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.3]))
SLOTS = 3


class Session:
    def __init__(self):
        self.pool = PyramidPool(CAMERA, SLOTS)
        self.start = MapStart(self.pool, PixelSelector(self.pool), CAMERA, InitializationConfig())

    def add(self, k, image=None):
        image = SURFACE.render(se3.exp(k * STEP)) if image is None else image
        return self.start.add(Frame(k, 1.0, self.pool.build(image), np.eye(4), np.zeros(2)), START)

    def free_slots(self):
        slots = []
        with pytest.raises(IndexError):
            while True:
                slots.append(self.pool.build(np.zeros((CAMERA.height, CAMERA.width), np.uint8)))
        for slot in slots:
            self.pool.release(slot)
        return len(slots)


def test_a_map_begins_with_the_first_frame_and_the_pose_that_it_was_given():
    session = Session()
    assert session.add(0) is None
    assert "first frame" in session.start.message
    for k in range(1, 20):
        frames = session.add(k)
        if frames is not None:
            break
        assert session.start.message == "waiting for parallax"
        assert session.free_slots() == SLOTS - 1  # the first frame's is kept, and no other
    assert frames.first.stamp_ns == 0
    np.testing.assert_array_equal(frames.first.T_camera_world, START)
    direction = frames.first_map.T_frame_first[:3, 3] / np.linalg.norm(frames.first_map.T_frame_first[:3, 3])
    assert direction @ STEP[:3] > 0.99 * np.linalg.norm(STEP[:3])
    assert session.free_slots() == SLOTS - 2  # the newest frame's is kept for the map


def test_a_frame_that_cannot_be_aligned_is_the_next_first_one():
    session = Session()
    session.add(0)
    session.add(1)
    other = Surface(texture=type(SHARP)(seed=9, shortest=0.05, contrast=40.0, waves=24))
    assert session.add(2, other.render(np.eye(4))) is None
    assert "starting from this one" in session.start.message
    assert session.free_slots() == SLOTS - 1
    assert session.add(3, other.render(se3.exp(STEP))) is None
    assert session.start.message == "waiting for parallax"


def first_map(session, **settings):
    for k in range(1, 40):
        frames = session.add(k, **settings)
        if frames is not None:
            return k, frames
    raise AssertionError("no map")


def test_after_a_map_that_was_not_accepted_the_next_one_has_more_parallax():
    session = Session()
    session.add(0)
    k, frames = first_map(session)
    way = np.linalg.norm(frames.first_map.T_frame_first[:3, 3])
    assert set(session.start.slots) == {frames.first.image_slot}
    session.pool.release_all(session.start.slots)  # as when the map is not accepted
    for later in range(k + 1, 60):
        again = session.add(later)
        if again is not None:
            break
        assert session.start.message == "waiting for parallax"
    assert again.first.stamp_ns == 0
    assert np.linalg.norm(again.first_map.T_frame_first[:3, 3]) >= MORE_PARALLAX * way


def test_the_unit_is_known_from_a_motion_in_metres():
    metres = 4.0  # to the ceiling
    session = Session()
    session.add(0)
    for k in range(1, 40):
        T = se3.inverse(se3.exp(k * STEP))
        T[:3, 3] *= metres
        image = SURFACE.render(se3.exp(k * STEP))
        frame = Frame(k, 1.0, session.pool.build(image), np.eye(4), np.zeros(2))
        if session.start.add(frame, START, CameraMotion(T, 1e-6 * np.eye(6), metric=True)) is not None:
            break
    assert session.start.metres_per_unit == pytest.approx(metres, rel=0.05)
    assert session.start.first_ns == 0
