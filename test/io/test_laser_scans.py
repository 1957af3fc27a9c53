# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.laser_scans import ScanCollector, ScanGeometry

GEOMETRY = ScanGeometry(-1.0, 0.5, 0.001)
LIMITS = np.array([0.1, 30.0])


def collector():
    said = []
    return ScanCollector("some.bag, /scan", said.append), said


def test_ranges_that_are_no_returns_become_nan():
    scans, said = collector()
    scans.add(5, np.array([1.0, 0.0, np.nan, np.inf, -np.inf, 0.05, 31.0, 29.9]), GEOMETRY, LIMITS)
    found = scans.scans(np.eye(4))
    np.testing.assert_array_equal(np.isfinite(found.ranges_m[0]), [1, 0, 0, 0, 0, 0, 0, 1])
    assert found.valid_share == 0.25
    assert found.sweep_s[0] == pytest.approx(0.007)
    assert said == []


@pytest.mark.parametrize("limits", [None, np.array([5.0, 1.0]), np.array([np.nan, np.nan]), np.array([0.0, 0.0])])
def test_limits_that_say_nothing_do_not_count(limits):
    scans, _ = collector()
    scans.add(5, np.array([0.0, 0.01, 3.0, 100.0]), GEOMETRY, limits)
    np.testing.assert_array_equal(np.isfinite(scans.scans(np.eye(4)).ranges_m[0]), [0, 0, 1, 1])


def test_scans_may_have_different_numbers_of_rays_and_come_out_of_order():
    scans, said = collector()
    scans.add(10, np.array([1.0, 2.0, 3.0]), GEOMETRY)
    scans.add(30, np.array([1.0, 2.0]), GEOMETRY)
    scans.add(20, np.array([9.0, 9.0]), GEOMETRY)
    scans.add(30, np.array([9.0, 9.0]), GEOMETRY)
    scans.add(40, np.array([4.0, 5.0]), ScanGeometry(1.0, -0.5, 0.0))
    found = scans.scans(np.eye(4))
    assert found.stamps_ns.tolist() in ([10, 30, 40], [10, 20, 40], [10, 20, 30, 40])
    assert found.stamps_ns[0] == 10 and found.ranges_m.shape[1] == 3
    assert np.isnan(found.ranges_m[1, 2])
    assert len(said) == 1 and "out of order" in said[0]
    chosen = found.select(np.array([0, len(found) - 1]))
    assert chosen.geometry[-1, 1] == -0.5


@pytest.mark.parametrize(
    ("geometry", "rays"),
    [
        (ScanGeometry(np.nan, 0.5, 0.0), 3),
        (ScanGeometry(0.0, 0.0, 0.0), 3),
        (ScanGeometry(0.0, 0.5, -0.1), 3),
        (ScanGeometry(0.0, 0.5, 0.0), 0),
        (ScanGeometry(0.0, 0.5, 0.0), 1000),
    ],
)
def test_impossible_scans_are_counted_and_none_at_all_is_an_error(geometry, rays):
    scans, said = collector()
    scans.add(1, np.ones(rays), geometry)
    with pytest.raises(InputError, match=r"some\.bag, /scan: has no scans that can be used"):
        scans.scans(np.eye(4))
    assert "1 of 1 scans are not used" in said[0]


def test_no_scan_and_no_return_at_all_are_errors():
    scans, _ = collector()
    with pytest.raises(InputError, match="there are none"):
        scans.scans(np.eye(4))
    scans.add(1, np.full(10, np.inf), ScanGeometry(0.0, 0.1, 0.0))
    with pytest.raises(InputError, match="no ray of any of its 1 scans has a valid range"):
        scans.scans(np.eye(4))
