# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.rendering.geometry import box, quad
from ceiling_dso_ros.simulation.rendering.lighting import AMBIENT, Source, floor_sources, irradiance
from ceiling_dso_ros.simulation.rendering.materials import STEEL
from ceiling_dso_ros.simulation.rendering.scene import build_mesh

CEILING = [quad((-20, 20, 4), (40, 0, 0), (0, -40, 0), STEEL)]
DOWN = np.array([0.0, 0.0, -1.0])


def light_at(points, sources, extra=()):
    points = np.atleast_2d(np.array(points, dtype=float))
    normals = np.tile(DOWN, (len(points), 1))
    return irradiance(build_mesh([*CEILING, *extra]), sources, points, normals) - AMBIENT


def test_a_wide_floor_lights_a_ceiling_with_about_one():
    sources = floor_sources((60.0, 60.0), np.random.default_rng(0))
    assert light_at([0, 0, 4], sources)[0] == pytest.approx(1.0, abs=0.15)


def test_a_lamp_follows_the_inverse_square_and_the_cosine():
    lamp = Source(np.array([0.0, 0.0, 3.0]), 0.5, False)
    below, aside = light_at([[0, 0, 4], [1, 0, 4]], [lamp])
    assert below == pytest.approx(0.5)
    assert aside == pytest.approx(0.5 / 2 / np.sqrt(2), rel=1e-6)


def test_light_does_not_pass_through_things():
    lamp = Source(np.array([0.0, 0.0, 1.0]), 1.0, False)
    board = box((0, 0, 2.5), (1.0, 1.0, 0.1), STEEL)
    behind, beside = light_at([[0, 0, 4], [1.5, 0, 4]], [lamp], board)
    assert behind == 0.0
    assert beside > 0.05


def test_nothing_shades_itself():
    lamp = Source(np.array([0.3, 0.2, 1.0]), 1.0, False)
    points = np.column_stack([*(axis.ravel() for axis in np.meshgrid(np.linspace(-4, 4, 33), np.linspace(-4, 4, 33)))])
    assert (light_at(np.column_stack([points, np.full(len(points), 4.0)]), [lamp]) > 0).all()


def test_what_is_turned_away_or_below_gets_only_ambient_light():
    lamp = Source(np.array([0.0, 0.0, 3.0]), 1.0, False)
    up, below = irradiance(
        build_mesh(CEILING), [lamp], np.array([[0.0, 0, 3.5], [0.0, 0, 2.0]]), np.array([[0.0, 0, 1], [0.0, 0, -1]])
    )
    assert up < below == pytest.approx(AMBIENT)
