# SPDX-License-Identifier: BSD-3-Clause
"""Images whose stamps are wrong, one by one or since a clock was set."""

import numpy as np
import pytest

from ceiling_dso_ros.io.frame_order import judged
from ceiling_dso_ros.io.recording import ListedImage, WheelSamples, WheelUnit

START_NS, INTERVAL_NS, HOUR_NS = 1_764_400_000 * 10**9, 33_333_333, 3600 * 10**9
IN_ORDER = (START_NS + INTERVAL_NS * np.arange(40)).tolist()


def wheels(arrivals_ns=None, set_back=False):
    """Of a robot that stands."""
    stamps_ns = np.array([START_NS])
    return WheelSamples(WheelUnit.TICKS, stamps_ns, np.zeros((1, 2)), set_back=set_back, arrivals_ns=arrivals_ns)


def faults(stamps_ns, wheels=wheels(), recorded_ns=None):
    """What is wrong with each image, in their order."""
    images = [
        ListedImage(stamp_ns, None, f"image {k}", lambda: np.zeros((2, 2)), recorded_ns and recorded_ns[k])
        for k, stamp_ns in enumerate(stamps_ns)
    ]
    judgement = list(judged(images, wheels))
    assert [image for image, _ in judgement] == images  # nothing is left out, and the order is that of the recording
    return [fault for _, fault in judgement]


def test_images_in_order_are_right_also_after_a_pause_and_without_stamps():
    after_a_pause = [stamp_ns + HOUR_NS for stamp_ns in IN_ORDER]
    assert not any(faults([*IN_ORDER, *after_a_pause, None, after_a_pause[-1] + 1]))
    assert not any(faults([*IN_ORDER, IN_ORDER[-1] + HOUR_NS]))


@pytest.mark.parametrize("by_ns", [HOUR_NS, 2 * 10**9])
@pytest.mark.parametrize("index", [0, 20])
def test_one_stamp_in_the_future_costs_one_image(by_ns, index):
    stamps_ns = list(IN_ORDER)
    stamps_ns[index] += by_ns
    wrong = faults(stamps_ns)
    assert "far ahead" in wrong[index]
    assert sum(map(bool, wrong)) == 1


@pytest.mark.parametrize("by_ns", [INTERVAL_NS * 5, 10**9, HOUR_NS])
@pytest.mark.parametrize("index", [1, 20])
def test_one_stamp_in_the_past_costs_one_image(by_ns, index):
    stamps_ns = list(IN_ORDER)
    stamps_ns[index] -= by_ns
    wrong = faults(stamps_ns)
    assert "lies before" in wrong[index] or "far ahead" in wrong[0]  # of the first two, either may be wrong
    assert sum(map(bool, wrong)) == 1


def test_images_that_changed_places_are_no_clock():
    stamps_ns = list(IN_ORDER)
    stamps_ns[20], stamps_ns[21] = stamps_ns[21], stamps_ns[20]
    wrong = faults(stamps_ns)
    assert "lies before" in wrong[21]
    assert sum(map(bool, wrong)) == 1


@pytest.mark.parametrize("back_s", [0.1, 0.3, 1.0, 3600.0])
def test_a_camera_whose_clock_alone_was_set_back_is_not_used_any_more(back_s):
    """Its later stamps look right again, and are wrong by as much."""
    stamps_ns = IN_ORDER[:20] + [stamp_ns - round(1e9 * back_s) for stamp_ns in IN_ORDER[20:]]
    wrong = faults(stamps_ns)
    assert not any(wrong[:20])
    assert all(f"set back by {back_s:.2f} s, that of the wheels was not" in fault for fault in wrong[20:])


def test_with_the_wheels_clock_or_alone_images_go_on_when_their_stamps_do():
    stamps_ns = IN_ORDER[:20] + [stamp_ns - 9 * INTERVAL_NS for stamp_ns in IN_ORDER[20:]]
    wrong = faults(stamps_ns, wheels(set_back=True))
    assert [bool(fault) for fault in wrong] == [False] * 20 + [True] * 9 + [False] * 11


class Recorder:
    """When images and wheel samples are recorded, each a random time after it was stamped."""

    def __init__(self, images=900, samples=1500, rate_hz=30.0):
        random = np.random.default_rng(0)
        self.taken_ns = START_NS + (1e9 / rate_hz * np.arange(images)).astype(np.int64)
        self.recorded_ns = (self.taken_ns + (1e9 * random.exponential(0.02, images)).astype(np.int64)).tolist()
        self.sampled_ns = START_NS + 20_000_000 * np.arange(samples)
        self.heard_ns = self.sampled_ns + (1e9 * random.exponential(0.003, samples)).astype(np.int64)

    def faults(self, camera_s=0.0, wheels_s=0.0):
        """What is wrong with the images if clocks are set for the middle third of the recording."""
        stamps_ns, sampled_ns = self.taken_ns.copy(), self.sampled_ns.copy()
        for each_ns, set_s in ((stamps_ns, camera_s), (sampled_ns, wheels_s)):
            third = len(each_ns) // 3
            each_ns[third : 2 * third] += round(1e9 * set_s)
        table_ns = np.stack([sampled_ns, self.heard_ns], axis=1)[np.argsort(self.heard_ns, kind="stable")]
        return faults(stamps_ns.tolist(), wheels(table_ns, set_back=wheels_s < 0.0), self.recorded_ns)


@pytest.mark.parametrize("clock", ["camera_s", "wheels_s"])
@pytest.mark.parametrize("set_s", [-3600.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3600.0])
def test_when_they_were_recorded_tells_which_images_have_the_wheels_clock(clock, set_s):
    wrong = Recorder().faults(**{clock: set_s})
    stream = "images" if clock == "camera_s" else "wheels"
    assert not any(wrong[:299])
    assert all(
        f"clock of the {stream} was set {'ahead' if set_s > 0.0 else 'back'} by" in fault for fault in wrong[301:599]
    )
    assert not any(wrong[603:])  # until single images that came late are outweighed


def test_clocks_that_were_set_together_still_agree():
    wrong = Recorder().faults(camera_s=-0.3, wheels_s=-0.3)
    assert [fault for fault in wrong if "that of the wheels was not" in fault][5:] == []
