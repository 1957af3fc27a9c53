# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.visual import VisualMotion

SCALE = 4.2


def mount():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("ZYX", [-88.0, -1.0, 1.5], degrees=True).as_matrix()
    T[:3, 3] = 0.18, 0.04, 0.62
    return T


def seen(motion, tilt=(0.0, 0.0), climb_m=0.0):
    """What a camera sees of a base that moves, and nods about x and y and climbs."""
    wobble = np.eye(4)
    wobble[:3, :3] = Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
    wobble[2, 3] = climb_m
    T = np.linalg.inv(mount()) @ planar.lift(motion) @ wobble @ mount()
    T[:3, 3] /= SCALE
    return VisualMotion.from_camera(T, mount())


@pytest.mark.parametrize("motion", [(0.3, 0.0, 0.0), (0.0, 0.0, 0.4), (0.2, 0.05, -0.3)])
def test_a_tilted_camera_off_the_centre_tells_the_motion_of_the_base(motion):
    np.testing.assert_allclose(seen(motion).base_motion(SCALE), motion, atol=1e-12)
    assert seen(motion).on_floor(VisualConfig())


def test_a_nod_of_the_base_is_not_taken_for_a_motion():
    """Two milliradians at 0.62 m of height are 1.2 mm, more than the camera's noise."""
    motion = (0.15, 0.0, 0.05)
    nodding = seen(motion, tilt=(0.002, -0.002))
    np.testing.assert_allclose(nodding.base_motion(SCALE), motion, atol=1e-4)
    ignored = SCALE * nodding.shift - (planar.rotation(0.05) - np.eye(2)) @ [0.18, 0.04]
    assert np.abs(ignored - motion[:2]).max() > 1e-3


@pytest.mark.parametrize(
    ("motion", "possible"),
    [((0.3, 0.03, 0.2), True), ((0.3, 0.1, 0.2), False), ((0.0, 0.05, 0.0), False), ((-0.3, 0.03, -0.2), True)],
)
def test_wheels_hardly_move_sideways(motion, possible):
    assert seen(motion).on_floor(VisualConfig())
    assert seen(motion).on_wheels(SCALE, VisualConfig()) == possible


@pytest.mark.parametrize("wobble", [{"tilt": (0.05, 0.0)}, {"climb_m": 0.2}])
def test_tilting_or_climbing_is_no_motion_on_a_floor(wobble):
    assert not seen((0.15, 0.0, 0.05), **wobble).on_floor(VisualConfig())
