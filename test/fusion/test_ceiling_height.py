# SPDX-License-Identifier: BSD-3-Clause
import math

import pytest

from ceiling_dso_ros.fusion.ceiling_height import LONGEST_DOUBT_M, CeilingHeight


@pytest.fixture
def known():
    """A ceiling of 4 m."""
    height = CeilingHeight()
    height.see(math.log(4.0), 1.0, 1.0)
    assert height.agrees
    height.believe()
    height.begin_segment()
    return height


def test_another_unit_of_the_same_height_agrees(known):
    known.see(math.log(8.0), 0.5, 0.2)
    assert known.agrees


@pytest.mark.parametrize("factor", [0.5, 0.75, 1.3, 2.0])
def test_a_scale_that_would_raise_or_lower_the_ceiling_is_doubted_for_a_while(known, factor):
    known.see(math.log(8.0 * factor), 0.5, 0.2)
    assert not known.agrees
    known.see(math.log(8.0 * factor), 0.5, LONGEST_DOUBT_M)
    assert known.agrees


def test_a_map_of_another_unit_has_the_scale_of_the_same_height(known):
    assert known.log_scale(0.5) == pytest.approx(math.log(8.0))
    assert math.isnan(known.log_scale(math.nan))
    known.forget()
    assert math.isnan(known.log_scale(0.5))


def test_where_no_depth_is_known_nothing_is_doubted(known):
    known.see(math.log(80.0), math.nan, 0.2)
    assert known.agrees
