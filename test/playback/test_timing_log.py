# SPDX-License-Identifier: BSD-3-Clause
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState
from ceiling_dso_ros.playback.timing_log import TimingLog


def log_of_three():
    log = TimingLog()
    tracking = TrackingState.TRACKING
    log.add(OdometryStatus(1_500_000_000, TrackingState.INITIALIZING, 0, timing_ms={"pyramid": 1.0}), 30.0)
    keyframe_ms = {"pyramid": 2.0, "optimise": 9.5}
    log.add(OdometryStatus(1_600_000_000, tracking, 0, is_keyframe=True, timing_ms=keyframe_ms), 20.0)
    log.add(OdometryStatus(1_700_000_000, tracking, 0, timing_ms={"pyramid": 3.0}), 4.0)
    return log


def test_statistics_by_kind_of_frame():
    statistics_ms = log_of_three().statistics_ms()
    assert statistics_ms["all"]["mean"] == 18.0
    assert statistics_ms["all"]["median"] == 20.0
    assert statistics_ms["all"]["max"] == 30.0
    assert statistics_ms["keyframes"] == {"mean": 20.0, "median": 20.0, "p95": 20.0, "max": 20.0}
    assert statistics_ms["others"]["mean"] == 4.0  # frames that wait for a first pose are no others


def test_statistics_of_nothing_are_unknown():
    assert TimingLog().statistics_ms()["keyframes"] == {"mean": None, "median": None, "p95": None, "max": None}


def test_csv_has_a_row_for_each_frame_and_a_column_for_each_stage(tmp_path):
    log_of_three().write_csv(tmp_path / "timing.csv")
    assert (tmp_path / "timing.csv").read_text().splitlines() == [
        "stamp,total_ms,pyramid_ms,optimise_ms,is_keyframe,state",
        "1.500000000,30.000,1.000,0.000,0,initializing",
        "1.600000000,20.000,2.000,9.500,1,tracking",
        "1.700000000,4.000,3.000,0.000,0,tracking",
    ]


def test_counts_states():
    log = log_of_three()
    assert len(log) == 3
    assert log.count(TrackingState.TRACKING) == 2
    assert log.count(TrackingState.LOST) == 0
