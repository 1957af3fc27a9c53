# SPDX-License-Identifier: BSD-3-Clause
"""Images whose stamps are wrong, one by one or since a clock was set."""

import numpy as np
import pytest

from ceiling_dso_ros.io.frame_order import judged
from ceiling_dso_ros.io.recording import ListedImage

START_NS, INTERVAL_NS, HOUR_NS = 1_764_400_000 * 10**9, 33_333_333, 3600 * 10**9
IN_ORDER = (START_NS + INTERVAL_NS * np.arange(40)).tolist()


def faults(stamps_ns, alone=True):
    """What is wrong with each image, in their order."""
    images = [
        ListedImage(stamp_ns, None, f"image {k}", lambda: np.zeros((2, 2))) for k, stamp_ns in enumerate(stamps_ns)
    ]
    judgement = list(judged(images, alone))
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
    wrong = faults(stamps_ns, alone=False)
    assert [bool(fault) for fault in wrong] == [False] * 20 + [True] * 9 + [False] * 11
