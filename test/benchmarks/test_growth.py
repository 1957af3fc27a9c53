# SPDX-License-Identifier: BSD-3-Clause
"""Tables and figures of what was measured, without measuring."""

import pytest
from support.bounds import KernelCost, Rates
from support.bounds import describe as describe_bounds
from support.growth import Growth, Variation, describe, stage_means_ms, variations, write_figure

RESULT = {
    "frame_ms": {"all": 12.0, "keyframes": 40.0, "others": 5.0},
    "stage_ms": {
        "keyframes": {"undistort": 0.5, "pyramid": 0.5, "track": 2.0, "trace": 2.0, "optimize": 20.0, "select": 4.0},
        "others": {"undistort": 0.5, "pyramid": 0.5, "track": 2.0, "trace": 1.0},
    },
    "peak_memory_mb": 380.0,
}


def test_stages_are_weighted_by_the_share_of_keyframes():
    """A fifth of the images: 0.2 x 40 + 0.8 x 5 = 12 ms."""
    stages = stage_means_ms(RESULT)
    assert stages["image"] == pytest.approx(1.0)
    assert stages["track"] == pytest.approx(2.0)
    assert stages["trace"] == pytest.approx(0.2 * 2.0 + 0.8 * 1.0)
    assert stages["optimise"] == pytest.approx(4.0)
    assert stages["select, reference"] == pytest.approx(0.8)


def test_every_quantity_has_its_row_and_its_bars(tmp_path):
    found = [Growth(variation, RESULT) for variation in variations()]
    table = describe(found).splitlines()
    assert len(table) == 2 + len(found)
    assert "points 4000" in table[5]
    assert "12.00" in table[5]
    write_figure(tmp_path / "growth.svg", found)
    assert "<svg" in (tmp_path / "growth.svg").read_text()


def test_settings_name_what_grows():
    assert Variation("points", "500", ("window.active_points=500", "window.candidate_points=375")) in set(variations())
    assert [variation.size for variation in variations() if variation.quantity == "image"][-1] == (1280, 720)


def test_the_tightest_bound_is_named():
    rates = Rates(loads=2.0, flops=100.0, bytes=50.0)
    cost = KernelCost("trace", milliseconds=3.0, loads=4e6, flops=5e7, bytes=0.0)
    assert cost.bounds_ms(rates) == pytest.approx({"loads": 2.0, "arithmetic": 0.5, "memory": 0.0})
    row = describe_bounds(rates, [cost]).splitlines()[2]
    assert "| loads" in row
    assert "1.500" in row
