# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.rendering.geometry import beam, box, disk, polygon, quad, tube
from ceiling_dso_ros.simulation.rendering.materials import STEEL

SOLIDS = {
    "upright box": box((1.0, 2.0, 3.0), (0.5, 0.3, 0.2), STEEL, yaw=0.7),
    "slanted beam": beam((0.0, 0.0, 1.0), (1.0, 2.0, 4.0), 0.2, 0.1, STEEL),
    "upright column": beam((0.0, 0.0, 0.0), (0.0, 0.0, 4.0), 0.2, 0.1, STEEL, up=(1, 0, 0)),
    "slanted tube": tube((0.0, 1.0, 2.0), (2.0, 1.0, 3.0), 0.3, STEEL, sides=9, capped=True),
    "upright tube": tube((0.0, 1.0, 3.0), (0.0, 1.0, 2.0), 0.3, STEEL, sides=8, capped=True),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_closed_and_face_outward(name):
    surfaces = SOLIDS[name]
    areas = np.array([polygon_area(s.vertices) for s in surfaces])
    normals = np.array([s.normal for s in surfaces])
    middle = np.mean([s.vertices.mean(axis=0) for s in surfaces], axis=0)

    np.testing.assert_allclose(areas @ normals, 0.0, atol=1e-12)  # Gauss: holds for a closed surface only
    for surface in surfaces:
        assert surface.normal @ (surface.vertices.mean(axis=0) - middle) > 0.0


@pytest.mark.parametrize("name", SOLIDS)
def test_texture_axes_lie_in_the_plane_and_keep_hands(name):
    for surface in SOLIDS[name]:
        np.testing.assert_allclose(np.cross(surface.axis_u, surface.axis_v), surface.normal, atol=1e-12)
        corners = surface.vertices - surface.origin
        assert (corners @ surface.axis_u).min() == pytest.approx(0.0, abs=1e-12)
        assert (corners @ surface.axis_v).min() == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(corners @ surface.normal, 0.0, atol=1e-12)


def test_a_pattern_runs_on_around_a_tube():
    sides = tube((0.0, 0.0, 3.0), (2.0, 0.0, 3.0), 0.3, STEEL, sides=12)
    assert len({id(side.sheet) for side in sides}) == 1
    for one, next_one in zip(sides[:-1], sides[1:]):
        top_edge = one.origin + one.axis_v * one.extent_m[1]
        np.testing.assert_allclose(top_edge, next_one.origin, atol=1e-12)
        assert next_one.offset_m[1] == pytest.approx(one.offset_m[1] + one.extent_m[1])
        np.testing.assert_allclose(one.edge_normals[1], next_one.edge_normals[0])


def test_tube_has_the_light_of_a_round_bar():
    for side in tube((0.0, 0.0, 3.0), (2.0, 0.0, 3.0), 0.3, STEEL, sides=12):
        np.testing.assert_allclose(
            side.edge_normals.sum(axis=0), side.normal * np.linalg.norm(side.edge_normals.sum(axis=0))
        )


def test_quad_and_polygon_are_seen_from_where_they_run_counter_clockwise():
    np.testing.assert_allclose(quad((0, 0, 4), (0, 1, 0), (1, 0, 0), STEEL).normal, [0, 0, -1])
    np.testing.assert_allclose(polygon([(0, 0, 0), (1, 0, 0), (0, 1, 0)], STEEL).normal, [0, 0, 1])
    lamp = disk((0, 0, 3), (0, 0, -1), 0.2, STEEL)
    np.testing.assert_allclose(lamp.normal, [0, 0, -1], atol=1e-12)
    assert polygon_area(lamp.vertices) == pytest.approx(np.pi * 0.2**2, rel=0.02)


def test_oblique_polygon_keeps_the_wanted_direction():
    triangle = polygon([(0, 0, 0), (1, 1, 0), (0, 1, 0)], STEEL, along=(0, 1, 5))
    np.testing.assert_allclose(triangle.axis_u, [0, 1, 0], atol=1e-12)
    assert triangle.extent_m == pytest.approx((1.0, 1.0))


def polygon_area(vertices):
    return 0.5 * np.linalg.norm(np.cross(vertices, np.roll(vertices, -1, axis=0)).sum(axis=0))
