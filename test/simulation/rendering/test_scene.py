# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.obstacles import Obstacles
from ceiling_dso_ros.simulation.rendering.geometry import quad, tube
from ceiling_dso_ros.simulation.rendering.materials import Material
from ceiling_dso_ros.simulation.rendering.renderer import SAMPLE_TIMES, Renderer
from ceiling_dso_ros.simulation.rendering.scene import TEXEL_LEVELS, Hall, build_scene
from ceiling_dso_ros.simulation.robot import upward_camera

SMALL = CameraModel(width=212, height=120)


def views(count=40):
    """T_world_camera of an upward camera at random places where a robot drives, (count, 4, 4)."""
    rng = np.random.default_rng(5)
    T = np.tile(np.eye(4), (count, 1, 1))
    yaw = rng.uniform(0, 2 * np.pi, count)
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = np.cos(yaw), -np.sin(yaw), np.sin(yaw), np.cos(yaw)
    T[:, 0, 3], T[:, 1, 3] = rng.uniform(-7, 7, count), rng.uniform(-5, 5, count)
    return T @ upward_camera()


def picture(scene, camera, T):
    return Renderer(scene, camera.pinhole).expose(np.tile(T, (len(SAMPLE_TIMES), 1, 1)))


@pytest.fixture(scope="module", params=CEILINGS)
def ceiling(request):
    hall = CEILINGS[request.param](np.random.default_rng([3, 0]))
    return request.param, hall, build_scene(hall, SMALL.lens.fx, 3)


@pytest.mark.long
def test_a_hall_is_closed(ceiling):
    _, _, scene = ceiling
    renderer = Renderer(scene, SMALL.pinhole)
    for T in views():
        inverse_depth = renderer.inverse_depth(T)
        assert (inverse_depth > 0).all(), "every ray ends somewhere"
        assert inverse_depth.max() < 1 / 0.3


def test_ceilings_look_like_ceilings(ceiling):
    name, _, scene = ceiling
    grey = np.stack([np.clip(255 * picture(scene, SMALL, T), 0, 255) for T in views(12)])
    assert 30 < np.median(grey) < 190
    assert 0.0005 < (grey >= 250).mean() < 0.25, "lamps saturate, little else"
    contrast = np.abs(np.diff(grey, axis=2))
    assert np.median(contrast) < 4.0, "most of it has little contrast"
    assert np.percentile(contrast, 99.5) > (4.0 if name == "plaster" else 15.0), "but there is something to see"


@pytest.mark.long
def test_a_ceiling_is_the_same_at_every_resolution(ceiling):
    _, hall, scene = ceiling
    double = CameraModel(width=424, height=240)
    fine = build_scene(hall, double.lens.fx, 3)
    for T in views(3):
        small, large = picture(scene, SMALL, T), picture(fine, double, T)
        binned = large.reshape(120, 2, 212, 2).mean(axis=(1, 3))
        difference = 255 * np.abs(np.minimum(small, 1.0) - np.minimum(binned, 1.0))
        assert np.median(difference) < 3.0
        assert difference.mean() < 5.0


def test_what_cannot_be_seen_from_the_floor_costs_nothing(ceiling):
    _, hall, scene = ceiling
    assert len(scene.mesh.radii) <= len(hall.surfaces)
    assert scene.textures.texels.size < 4e6


def test_the_same_seed_paints_the_same(ceiling):
    name, hall, scene = ceiling
    if name != "plaster":
        pytest.skip("one ceiling is enough")
    np.testing.assert_array_equal(build_scene(hall, SMALL.lens.fx, 3).textures.texels, scene.textures.texels)
    other = build_scene(hall, SMALL.lens.fx, 4).textures.texels
    assert (other != scene.textures.texels).mean() > 0.5


def test_luminous_surfaces_are_not_lit_and_others_are():
    lamp, board = Material(0.7, luminous=True), Material(0.5)
    surfaces = [quad((-5, 5, 4), (5, 0, 0), (0, -10, 0), lamp), quad((0, 5, 4), (5, 0, 0), (0, -10, 0), board)]
    hall = Hall(surfaces, [], (10.0, 10.0), Obstacles(np.zeros((0, 2, 2))))
    scene = build_scene(hall, 100.0, 0)
    first, second = (
        scene.textures.texels[start : start + rows * columns] / TEXEL_LEVELS
        for start, (rows, columns) in zip(scene.textures.starts, scene.textures.shapes)
    )
    np.testing.assert_allclose(first, 0.7, atol=1e-3)
    assert 0.1 < second.mean() < 0.6
    assert np.ptp(second) > 0.05, "the edge of the hall is darker"


def test_facets_of_a_tube_share_their_sheet_without_seams():
    """The texture of a facet ends where that of the next one begins."""

    def paint(canvas):
        canvas.noise((0.3, 0.3), 0.2)

    sides = tube((-2, 0, 3), (2, 0, 3), 0.4, Material(0.5, paint, luminous=True), sides=12)
    lower = [side for side in sides if side.normal[2] < -0.3]
    scene = build_scene(Hall(lower, [], (10.0, 10.0), Obstacles(np.zeros((0, 2, 2)))), 200.0, 0)
    textures = scene.textures
    texel_m = 1 / np.linalg.norm(textures.axes[0, 1])
    parts = [
        textures.texels[start : start + rows * columns].reshape(rows, columns) / TEXEL_LEVELS
        for start, (rows, columns) in zip(textures.starts, textures.shapes)
    ]
    for side, one, next_one in zip(lower[:-1], parts[:-1], parts[1:]):
        last_row = round(side.extent_m[1] / texel_m)
        assert np.abs(one[last_row] - next_one[0]).mean() < 0.01 < np.abs(one[0] - next_one[0]).mean()
