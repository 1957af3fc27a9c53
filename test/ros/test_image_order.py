# SPDX-License-Identifier: BSD-3-Clause
"""Which images the fusion may use, by their stamps on the wheels' clock."""

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from ceiling_dso_ros.ros.data_clock import BACKWARDS_NS  # noqa: E402
from ceiling_dso_ros.ros.image_order import AGREEING, CAMERA_AHEAD_NS, ImageOrder  # noqa: E402

NOW_NS = 1_732_800_000_123_456_789
FRAME_NS = 33_333_333


class Stream:
    """Images after wheel samples that were heard some time ago."""

    def __init__(self, is_simulated=False, silence_s=0.01):
        self.complaints, self.now_s = [], 100.0
        self.order = ImageOrder(is_simulated, lambda: self.now_s)
        self.order.heard_wheels()
        self.now_s += silence_s

    def image(self, stamp_ns, wheels_ns=NOW_NS):
        return self.order.is_usable(stamp_ns, wheels_ns, self.complaints.append)


def test_images_in_order_are_used():
    stream = Stream()
    assert all(stream.image(NOW_NS + k * FRAME_NS, NOW_NS + k * FRAME_NS) for k in range(5))
    assert stream.complaints == []


def test_images_before_the_wheels_and_of_the_run_before_are_left_out_in_silence():
    stream = Stream(is_simulated=True)
    assert not stream.image(NOW_NS, wheels_ns=None)
    assert not stream.image(NOW_NS + CAMERA_AHEAD_NS + 1)
    assert stream.image(NOW_NS)
    assert stream.image(NOW_NS + CAMERA_AHEAD_NS + 1)  # a camera that is known may run ahead
    assert stream.complaints == []


def test_an_image_far_ahead_is_refused_while_wheels_are_heard_on_a_clock_that_may_be_set():
    far_ns = NOW_NS + BACKWARDS_NS + 1
    assert not Stream().image(far_ns)
    assert Stream(silence_s=1.0).image(far_ns)  # the wheels are silent: the camera goes on alone
    assert Stream(is_simulated=True).image(far_ns)


@pytest.mark.parametrize("back_ns", [0, 1, FRAME_NS])
def test_an_image_that_is_not_later_is_refused_and_named(back_ns):
    stream = Stream()
    assert stream.image(NOW_NS)
    assert not stream.image(NOW_NS - back_ns)
    assert "not later" in stream.complaints[0]


def test_a_new_run_begins_with_any_image():
    stream = Stream()
    stream.image(NOW_NS)
    stream.order.reset()
    assert stream.image(NOW_NS - 10 * FRAME_NS)


def test_two_clocks_are_said_with_how_far_they_are_apart():
    stream = Stream(is_simulated=True)
    stream.image(NOW_NS - FRAME_NS)
    assert stream.order.apart == ""
    assert not stream.image(NOW_NS + 3600 * 10**9, wheels_ns=None)
    assert stream.order.apart == ""
    stream.image(NOW_NS + 3600 * 10**9)
    assert (
        stream.order.apart
        == "stamps of images are 3600.0 s after those of the wheels: two clocks, or the wheels come late"
    )
    assert stream.image(NOW_NS)  # that one was wrong
    stream = Stream()
    stream.image(NOW_NS - 2 * 10**9)
    assert stream.order.apart == (
        "stamps of images are 2.0 s before those of the wheels: two clocks, or images come late"
    )
    stream.order.reset()
    assert stream.order.apart == ""


def test_images_that_go_on_while_the_wheels_are_silent_are_on_one_clock_with_them():
    stream = Stream(silence_s=3.0)
    stream.image(NOW_NS + 3 * 10**9)
    assert stream.order.apart == ""


def test_a_camera_whose_clock_alone_is_set_back_is_not_used_until_it_is_right_again():
    stream, second_ns = Stream(), 10**9

    def drive(images, later_ns):
        nonlocal count
        for _ in range(images):
            count += 1
            now_ns = NOW_NS + count * FRAME_NS
            yield stream.image(now_ns - FRAME_NS + later_ns, now_ns)

    for back_ns in (-second_ns, -second_ns // 4, -second_ns // 10, -3600 * second_ns):
        count = 0
        assert all(drive(10, 0))
        assert not any(drive(90, back_ns))
        assert stream.order.camera_set_back
        assert f"set back by {-back_ns / second_ns:.1f} s" in stream.order.apart
        assert list(drive(10, 0)) == [False] * (AGREEING - 1) + [True] * (11 - AGREEING)
        assert stream.order.apart == ""
        stream.order.reset()


@pytest.mark.parametrize("ahead_s", [0.3, 0.45, 0.6])
@pytest.mark.parametrize("latency_s", [0.03, 0.12, 0.2])
@pytest.mark.parametrize("images", [1, 60])
def test_images_that_were_stamped_ahead_do_not_spoil_those_after_them(ahead_s, latency_s, images):
    stream = Stream()

    def drive(count, ahead_s):
        for _ in range(count):
            stream.number += 1
            now_ns = NOW_NS + stream.number * FRAME_NS
            yield stream.image(now_ns + round(1e9 * (ahead_s - latency_s)), now_ns)

    stream.number = 0
    assert all(drive(100, 0.0))
    list(drive(images, ahead_s))
    list(drive(round(ahead_s * 1e9 / FRAME_NS) + AGREEING, 0.0))  # until stamps are later than the last one again
    assert all(drive(20, 0.0))


def test_a_clock_that_is_set_for_all_costs_the_images_that_come_before_the_wheels_tell():
    stream = Stream()
    assert stream.image(NOW_NS)
    assert not stream.image(NOW_NS - 10**9)
    assert stream.order.camera_set_back
    assert [stream.image(NOW_NS + k * FRAME_NS, NOW_NS + k * FRAME_NS) for k in range(1, 5)].count(True) == 5 - AGREEING
    assert not stream.order.camera_set_back


@pytest.mark.parametrize("late_s", [0.3, 0.9, 3.0])
def test_images_that_come_late_in_their_order_are_used(late_s):
    stream, late_ns = Stream(), round(late_s * 1e9)
    assert all(stream.image(NOW_NS + k * FRAME_NS, NOW_NS + k * FRAME_NS) for k in range(3))
    assert all(stream.image(NOW_NS + k * FRAME_NS, NOW_NS + k * FRAME_NS + late_ns) for k in range(3, 9))
    assert all(stream.image(NOW_NS + k * FRAME_NS, NOW_NS + k * FRAME_NS) for k in range(9, 12))
