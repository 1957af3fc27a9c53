# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.dso.images.exposure_scale import ExposureScale


def scaled(*exposures_ms):
    scale = ExposureScale()
    return [scale.of(exposure_ms) for exposure_ms in exposures_ms]


def test_known_exposures_are_themselves():
    assert scaled(8.0, 4.1, 7.3) == [8.0, 4.1, 7.3]


@pytest.mark.parametrize("unknown", [None, 0.0, -1.0])
def test_an_unknown_exposure_is_that_of_the_last_image(unknown):
    assert scaled(8.0, unknown, unknown, 4.0) == [8.0, 8.0, 8.0, 4.0]


def test_without_any_exposure_all_are_equal():
    assert scaled(None, None, None) == [1.0, 1.0, 1.0]


def test_the_first_known_one_is_what_was_assumed_before_it():
    assert scaled(None, None, 8.0, 4.0, None, 16.0) == [1.0, 1.0, 1.0, 0.5, 0.5, 2.0]
