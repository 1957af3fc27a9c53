# SPDX-License-Identifier: BSD-3-Clause
import itertools

import pytest

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.images.pyramid import check_trackable
from ceiling_dso_ros.playback.trackable_size import trackable_size


@pytest.mark.parametrize("size", [(424, 240), (848, 480), (640, 480), (1920, 1080), (180, 136)])
def test_what_can_be_tracked_stays(size):
    assert trackable_size(*size) == size


@pytest.mark.parametrize(
    ("size", "cropped"),
    [((423, 239), (416, 232)), ((850, 482), (848, 480)), ((645, 485), (640, 480)), ((191, 143), (188, 140))],
)
def test_other_sizes_are_cropped(size, cropped):
    assert trackable_size(*size) == cropped


def test_every_size_that_is_large_enough_can_be_tracked_after_a_small_loss():
    for width, height in itertools.product(range(190, 1400, 67), range(130, 1000, 53)):
        cropped = trackable_size(width, height)
        check_trackable(PinholeCamera(300.0, 300.0, 50.0, 50.0, *cropped))
        assert 0.94 * width < cropped[0] <= width
        assert 0.94 * height < cropped[1] <= height


def test_an_image_that_is_too_small_is_left_for_the_odometry_to_refuse():
    assert trackable_size(161, 121) == (161, 121)
    with pytest.raises(ConfigError, match="161x121"):
        check_trackable(PinholeCamera(300.0, 300.0, 50.0, 50.0, 161, 121))
