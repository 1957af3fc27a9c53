# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.grey_range import GreyRange, check_bits


def image_up_to(brightest, dtype=np.uint16):
    return np.linspace(0, brightest, 48).reshape(6, 8).astype(dtype)


def units_of(grey_range, *images):
    return [grey_range.units(image) for image in images]


@pytest.mark.parametrize(
    ("brightest", "units", "white"),
    [
        (200, 1, "255 (8 bits)"),
        (256, 4, "1023 (10 bits)"),
        (4080, 16, "4095 (12 bits)"),
        (4095, 16, "4095 (12 bits)"),
        (16383, 64, "16383 (14 bits)"),
        (16384, 256, "65535 (16 bits)"),
    ],
)
def test_the_smallest_depth_that_the_brightest_pixels_fit_in_is_taken_and_said(brightest, units, white):
    told = []
    grey_range = GreyRange(tell=told.append)
    assert units_of(grey_range, *[image_up_to(brightest)] * 5) == [units] * 5
    assert len(told) == 1
    assert f"values up to {brightest}, so white is taken to be {white}; a given bit depth" in told[0]


@pytest.mark.parametrize(("brightest", "units"), [(0.9, 1 / 255), (1.0, 1 / 255), (250.0, 1), (4000.0, 16), (1e6, 256)])
def test_floats_from_zero_to_one_or_to_a_number_of_bits(brightest, units):
    assert units_of(GreyRange(), image_up_to(brightest, np.float32)) == [units]


def test_eight_bits_need_no_range():
    assert units_of(GreyRange(12, pytest.fail), *[image_up_to(255, np.uint8)] * 5) == [1.0] * 5


def test_images_that_are_brighter_later_enlarge_the_range():
    told = []
    grey_range = GreyRange(tell=told.append)
    dark, bright = image_up_to(900), image_up_to(4000)
    assert units_of(grey_range, *[dark] * 4, *[bright] * 4, *[dark] * 4) == [4] * 6 + [16] * 6
    assert len(told) == 2


@pytest.mark.parametrize("position", [0, 2, 6])
def test_a_single_damaged_image_does_not(position):
    images = [image_up_to(4000)] * 8
    images[position] = image_up_to(65535)
    units = units_of(GreyRange(), *images)
    assert units[max(position, 1) :] == [16] * (8 - max(position, 1))


def test_a_black_image_at_first_does_no_harm():
    assert units_of(GreyRange(), image_up_to(0), *[image_up_to(4000)] * 4)[-1] == 16


def test_a_given_depth_stays_and_images_beyond_it_are_said_once():
    told = []
    grey_range = GreyRange(12, told.append)
    assert units_of(grey_range, image_up_to(900), *[image_up_to(9000)] * 5) == [16] * 6
    assert told == ["an image has values up to 9000, more than 12 bits allow: they are white"]


@pytest.mark.parametrize("bits", [-1, 1, 7, 17, 32])
def test_depths_that_no_image_has(bits):
    with pytest.raises(InputError, match=f"--bits {bits}: 8 to 16, or 0"):
        check_bits(bits, "--bits")
    check_bits(0, "--bits")
    check_bits(12, "--bits")
