# SPDX-License-Identifier: BSD-3-Clause
"""Halls that are drawn at random."""

import numpy as np
import pytest

from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.ceilings.drawn.coverings import COVERINGS
from ceiling_dso_ros.simulation.ceilings.drawn.hangings import HANGINGS, LOWEST_M
from ceiling_dso_ros.simulation.ceilings.drawn.roofs import ROOFS, Roof, draw_roof
from ceiling_dso_ros.simulation.rendering import materials

pytestmark = pytest.mark.long

SEEDS = range(100)  # those for building


def hall(seed):
    return CEILINGS["random"](np.random.default_rng([seed, 0]))


@pytest.fixture(scope="module")
def halls():
    return [hall(seed) for seed in SEEDS]


def test_a_seed_is_a_hall(halls):
    again = hall(7)
    assert again.description == halls[7].description
    np.testing.assert_array_equal(
        np.concatenate([surface.vertices for surface in again.surfaces]),
        np.concatenate([surface.vertices for surface in halls[7].surfaces]),
    )
    assert len({str(each.description) for each in halls}) == len(halls)


def test_all_kinds_are_drawn(halls):
    described = [each.description for each in halls]
    assert {each["roof"] for each in described} == set(ROOFS)
    assert {each["covering"] for each in described} == set(COVERINGS)
    assert {name for each in described for name in each["hangings"]} == set(HANGINGS)
    assert {each["lamps"] for each in described} == {"tubes", "bays", "panels"}
    for name in ("lamps_off", "skylights", "sun_patches", "is_periodic"):
        assert 0 < sum(bool(each[name]) for each in described) < len(described), name
    lowest = [each["height_m"][0] for each in described]
    assert min(lowest) >= 2.5
    assert max(lowest) <= 12.0
    assert np.ptp(np.log(lowest)) > 1.0


def test_a_periodic_roof_has_no_dirt_and_nothing_that_is_not_regular(halls):
    periodic = [each.description for each in halls if each.description["is_periodic"]]
    for each in periodic:
        assert each["dirt"] == 0.0
        assert not {"cables", "hoist", "banners", "trays", "ducts"} & set(each["hangings"])
        assert each["lamps_off"] == each["sun_patches"] == 0
    assert len(periodic) > 5


def test_nothing_hangs_so_low_that_a_robot_would_meet_it(halls):
    for each in halls:
        inside = [surface for surface in each.surfaces if abs(surface.normal[2]) > 1e-6]  # walls reach to the floor
        low = min(surface.vertices[:, 2].min() for surface in inside)
        assert low > LOWEST_M - 0.35, each.description
        assert (np.abs(np.concatenate([surface.vertices[:, :2] for surface in inside])) < 25.0).all()


@pytest.mark.parametrize("kind", ROOFS)
def test_a_roof_covers_the_hall_and_is_seen_from_below(kind):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        roof = Roof(kind, (21.0, 15.0), np.array(ROOFS[kind](rng, 7.5, 4.0)))
        surfaces = roof.surfaces(materials.STEEL)
        assert roof.lowest_m == pytest.approx(4.0)
        area = 0.0
        for surface in surfaces:
            for x, y, z in surface.vertices:
                below = [roof.section[:, 1][roof.section[:, 0] == y]]
                assert min(np.abs(np.concatenate(below) - z)) < 1e-9
                assert abs(x) == pytest.approx(10.5)
            assert surface.normal[2] < 1e-9
            area += surface.extent_m[0] * surface.extent_m[1] * abs(surface.normal[2])
        assert area == pytest.approx(21.0 * 15.0)


def test_a_patch_lies_just_below_its_roof():
    roof = draw_roof(np.random.default_rng(4), (21.0, 15.0), 5.0)
    for y0, y1 in roof.planes():
        patch = roof.patch((1.0, 2.0), (y0 + 0.1, y1 - 0.1), materials.SKYLIGHT, 0.01)
        assert patch.normal[2] < 0.0
        heights = [roof.height(y) for y in patch.vertices[:, 1]]
        np.testing.assert_allclose(patch.vertices[:, 2], np.array(heights) - 0.01, atol=1e-9)


def test_a_low_roof_is_flat():
    assert all(draw_roof(np.random.default_rng(seed), (21.0, 15.0), 2.7).kind == "flat" for seed in range(20))
