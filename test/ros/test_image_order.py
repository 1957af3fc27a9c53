# SPDX-License-Identifier: BSD-3-Clause
"""Which images the fusion may use, by their stamps on the wheels' clock."""

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

from ceiling_dso_ros.ros.data_clock import BACKWARDS_NS  # noqa: E402
from ceiling_dso_ros.ros.image_order import CAMERA_AHEAD_NS, ImageOrder  # noqa: E402

NOW_NS = 1_732_800_000_123_456_789
FRAME_NS = 33_333_333
SECOND_NS = 10**9


class Stream:
    """Images after wheel samples that were heard some time ago."""

    def __init__(self, is_simulated=False, silence_s=0.01):
        self.complaints, self.now_ns = [], 100 * SECOND_NS
        self.order = ImageOrder(is_simulated, lambda: self.now_ns)
        self.order.heard_wheels(NOW_NS)
        self.now_ns += round(silence_s * SECOND_NS)

    def image(self, stamp_ns, wheels_ns=NOW_NS):
        self.order.heard_image(stamp_ns)
        return self.order.is_usable(stamp_ns, wheels_ns, self.complaints.append)

    def drive(self, images, camera_s=0.0, wheels_s=0.0, late_s=0.0):
        """Images, each after a wheel sample, by clocks that are wrong, the images late; yields which are used."""
        for _ in range(images):
            self.now_ns += FRAME_NS
            stamp_ns = NOW_NS + self.now_ns
            wheels_ns = stamp_ns + round(wheels_s * SECOND_NS)
            self.order.heard_wheels(wheels_ns)
            yield self.image(stamp_ns + round((camera_s - late_s) * SECOND_NS), wheels_ns)


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


@pytest.mark.parametrize("clock", ["camera_s", "wheels_s"])
@pytest.mark.parametrize("set_s", [-3600.0, -1.0, -0.3, -0.1, 0.1, 0.3, 0.45])
def test_a_clock_that_alone_is_set_costs_the_images_until_it_is_right_again(clock, set_s):
    stream = Stream()
    assert all(stream.drive(60))
    assert not any(stream.drive(90, **{clock: set_s}))
    assert stream.order.disagrees
    which = "images" if clock == "camera_s" else "wheels"
    was_set = f"clock of the {which} was set {'ahead' if set_s > 0.0 else 'back'} by {abs(set_s):.2f} s"
    assert was_set in stream.order.apart
    # Where stamps were ahead, those that are right are first before them.
    assert all([*stream.drive(60)][16:])
    assert stream.order.apart == ""
    assert not stream.order.disagrees
    assert not any(stream.drive(10, **{clock: set_s}))
    stream.order.reset()
    assert all(stream.drive(30, **{clock: set_s if abs(set_s) < 0.5 else 0.0}))


@pytest.mark.parametrize("set_s", [-3600.0, -1.5, -0.3, 0.3, 1.0, 3600.0])
def test_a_clock_that_is_set_for_all_costs_no_more_images_than_come_before_the_wheels_tell(set_s):
    stream = Stream()
    assert all(stream.drive(60))
    stream.image(NOW_NS + stream.now_ns + round(set_s * SECOND_NS), NOW_NS + stream.now_ns)
    *_, last = stream.drive(30, camera_s=set_s, wheels_s=set_s)
    assert last
    assert not stream.order.disagrees


@pytest.mark.parametrize("ahead_s", [0.3, 0.45, 0.6])
@pytest.mark.parametrize("latency_s", [0.03, 0.12, 0.2])
@pytest.mark.parametrize("images", [1, 60])
def test_images_that_were_stamped_ahead_do_not_spoil_those_after_them(ahead_s, latency_s, images):
    stream = Stream()
    assert all(stream.drive(100, late_s=latency_s))
    assert not any(stream.drive(images, camera_s=ahead_s, late_s=latency_s))
    assert all(stream.drive(20, late_s=latency_s))


@pytest.mark.parametrize("late_s", [0.3, 0.9, 3.0])
def test_images_that_come_late_in_their_order_are_used(late_s):
    stream = Stream()
    assert all(stream.drive(60))
    begin_ns = stream.now_ns
    stream.now_ns += round(late_s * SECOND_NS)
    for k in range(6):  # they come together
        assert stream.image(NOW_NS + begin_ns + (k + 1) * FRAME_NS, NOW_NS + stream.now_ns)
    assert all(stream.drive(60))
