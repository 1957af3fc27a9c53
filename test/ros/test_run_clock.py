# SPDX-License-Identifier: BSD-3-Clause
"""When a node begins a new run."""

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

import rospy  # noqa: E402

from ceiling_dso_ros.ros import run_clock  # noqa: E402
from ceiling_dso_ros.ros.data_clock import StampKind  # noqa: E402

MS, S, HOUR = 10**6, 10**9, 3600 * 10**9
BEGIN_NS = 1_700_000_000 * S


class Stream:
    """Stamps that a node hears while time is simulated, and the runs that it has begun.

    Attributes:
        clock_ns: of /clock; None where it does not say anything of the data's time.
    """

    def __init__(self, monkeypatch, interval_ns):
        monkeypatch.setattr(run_clock, "time_is_simulated", lambda: True)
        monkeypatch.setattr(rospy, "logwarn", lambda *_: None)
        monkeypatch.setattr(rospy, "get_time", lambda: 1e-9 * (self.clock_ns or 0))
        self.interval_ns, self.runs, self.clock_ns = interval_ns, 0, None
        self.clock = run_clock.RunClock()
        self.next_ns = BEGIN_NS

    def hear(self, count):
        """The kinds of the next stamps of a steady stream."""
        kinds = [self.take(self.next_ns + k * self.interval_ns) for k in range(count)]
        self.next_ns += count * self.interval_ns
        return kinds

    def take(self, stamp_ns):
        return self.clock.follow(stamp_ns, self.begin)

    def begin(self):
        self.runs += 1


@pytest.fixture(params=[20 * MS, 333 * MS, S], ids=["50 Hz", "3 Hz", "1 Hz"])
def stream(monkeypatch, request):
    stream = Stream(monkeypatch, request.param)
    stream.hear(10)
    return stream


@pytest.mark.parametrize("off_ns", [HOUR, 10 * S, -10 * S, -HOUR])
def test_a_single_wrong_stamp_costs_one_sample_and_no_run(stream, off_ns):
    for _ in range(3):
        stream.clock_ns = stream.next_ns
        assert stream.take(stream.next_ns + off_ns) is StampKind.DOUBTED
        assert set(stream.hear(5)) == {StampKind.NEXT}
    assert stream.runs == 0
    assert stream.clock.last_ns == stream.next_ns - stream.interval_ns


@pytest.mark.parametrize("back_ns", [10 * S, HOUR])
def test_two_stamps_of_the_past_begin_a_run(stream, back_ns):
    """/clock is late, or there is none."""
    stream.next_ns -= back_ns
    assert stream.hear(3) == [StampKind.DOUBTED, StampKind.BACK, StampKind.NEXT]
    assert stream.runs == 1
    assert stream.clock.last_ns == stream.next_ns - stream.interval_ns


@pytest.mark.parametrize("back_ns", [10 * S, HOUR])
def test_one_stamp_of_the_past_begins_a_run_when_the_clock_agrees(stream, back_ns):
    stream.next_ns -= back_ns
    stream.clock_ns = stream.next_ns + 10 * MS
    assert stream.hear(2) == [StampKind.BACK, StampKind.NEXT]
    assert stream.runs == 1


@pytest.mark.parametrize("clock_agrees", [False, True])
def test_after_a_pause_the_run_goes_on(stream, clock_agrees):
    stream.next_ns += HOUR
    stream.clock_ns = stream.next_ns if clock_agrees else None
    assert set(stream.hear(5)[0 if clock_agrees else 1 :]) == {StampKind.NEXT}
    assert stream.runs == 0


def test_a_slow_stream_is_believed_from_its_third_stamp_on(monkeypatch):
    stream = Stream(monkeypatch, 5 * S)
    assert stream.hear(5) == [StampKind.NEXT, StampKind.DOUBTED, *[StampKind.NEXT] * 3]


def test_where_the_clock_was_set_back_time_goes_on_by_what_has_elapsed(monkeypatch):
    """What came in between may have been left out, by this node or by the one before."""
    monkeypatch.setattr(run_clock, "time_is_simulated", lambda: False)
    monkeypatch.setattr(rospy, "logwarn", lambda *_: None)
    now_ns = 0
    clock = run_clock.RunClock(lambda: now_ns)
    for k in range(100):
        now_ns = k * 20 * MS
        back_ns = 300 * MS if k >= 50 else 0
        if not 50 <= k < 53:  # as the node before needs these to be sure
            clock.follow(BEGIN_NS + now_ns - back_ns, pytest.fail)
    assert clock.last_ns == BEGIN_NS + now_ns
