# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.evaluation.association import associate
from ceiling_dso_ros.evaluation.coverage import Coverage

BEGIN_NS = 1_732_800_000_123_456_789


def stamps(begin_s, end_s, rate_hz):
    return BEGIN_NS + np.rint(1e9 * np.arange(begin_s, end_s, 1.0 / rate_hz)).astype(np.int64)


def coverage(estimate_ns, reference_ns, tau_s=0.01):
    return Coverage.of(estimate_ns, reference_ns, *associate(estimate_ns, reference_ns, tau_s))


def test_all_of_a_whole_run_is_compared():
    found = coverage(stamps(0, 10, 20), stamps(0, 10, 100))
    assert (found.poses, found.pairs, found.early, found.late, found.unmatched, found.gaps) == (200, 200, 0, 0, 0, 0)
    assert found.describe("camera", 0.01) == []


def test_poses_without_a_partner_are_counted_by_where_they_are():
    reference = np.concatenate([stamps(1, 4, 100), stamps(5, 9, 100)])
    found = coverage(stamps(0, 10, 20), reference, 0.005)
    assert (found.early, found.late, found.unmatched) == (20, 20, 20)
    assert found.describe("camera", 0.005) == [
        "camera: 60 of 200 poses are not compared: 20 before the reference begins, 20 after it ends, 20 without a "
        "reference pose of their own within 0.005 s"
    ]


def test_times_of_the_reference_without_poses_are_said():
    estimate = np.concatenate([stamps(2, 4, 20), stamps(6, 7, 20), stamps(8.5, 9.5, 20)])
    found = coverage(estimate, stamps(0, 30, 100))
    assert (found.early, found.late, found.unmatched, found.gaps) == (0, 0, 0, 2)
    assert found.describe("fused", 0.01) == [
        "fused: no poses for 26.1 of 30.0 s of the reference: 2.0 s at its beginning, 3.6 s in 2 gaps, "
        "20.5 s at its end"
    ]
    assert found.numbers()["missing_s"] == [2.0, 20.54]


def test_a_gap_of_the_reference_itself_is_not_one_of_the_estimate():
    found = coverage(stamps(0, 10, 20), np.concatenate([stamps(0, 3, 100), stamps(7, 10, 100)]))
    assert (found.gaps, found.gaps_s) == (0, 0.0)
    assert found.unmatched > 70
