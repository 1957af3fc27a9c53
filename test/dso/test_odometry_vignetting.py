# SPDX-License-Identifier: BSD-3-Clause
"""The odometry through a lens that darkens the corners of the image."""

import numpy as np
import pytest
from flying import CONFIG, FRAME_NS, ate, pose, run, same, tracking, with_setting
from synthetic import CAMERA

from ceiling_dso_ros.dso import DirectOdometry
from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler
from ceiling_dso_ros.dso.images.vignette import Vignette

LENS = Vignette(CAMERA, (-0.3, -0.1))  # the corner has two thirds of the light


@pytest.fixture(scope="module")
def there_and_back(images):
    """Numbers of the images, three times over the arc."""
    forth = list(range(len(images)))
    return [*forth, *forth[-2::-1], *forth[1:]]


@pytest.fixture(scope="module")
def darkened(images, there_and_back):
    return [images[k] / LENS.inverse for k in there_and_back]


def corner(vignette):
    return np.exp(sum(vignette.coefficients))


def error(odometry, images, there_and_back):
    statuses = run(odometry, images)
    assert sum(tracking(statuses)) > 0.9 * len(statuses)
    return ate(statuses, [pose(k) for k in there_and_back])


def test_it_is_found_while_driving_and_the_error_is_smaller(darkened, there_and_back):
    odometry = DirectOdometry(CAMERA, CONFIG)
    found = error(odometry, darkened, there_and_back)
    assert corner(odometry.map.vignette) == pytest.approx(corner(LENS), abs=0.05)
    unknown = error(DirectOdometry(CAMERA, with_setting("images", vignetting=False)), darkened, there_and_back)
    assert found < 0.6 * unknown


def test_the_same_images_give_the_same_poses(darkened):
    odometry = DirectOdometry(CAMERA, CONFIG)
    first = run(odometry, darkened)
    odometry.reset()  # forgets the vignette, too
    same(first, run(odometry, darkened))


def test_beside_the_tracking_each_image_is_corrected_as_its_reference(darkened):
    """The mapping may change the vignette while an image is being tracked."""
    odometry = DirectOdometry(CAMERA, CONFIG, LiveScheduler())
    for k, image in enumerate(darkened):
        status = odometry.track(image, k * FRAME_NS)
    odometry._scheduler.wait()
    assert tracking([status]) == [True]
    window = odometry._segment.mapping._mapper.window
    vignettes = [window.pool.vignette(int(slot)) for slot in window.keyframes.image_slot[: window.count]]
    assert corner(vignettes[-1]) < 0.9
    assert all(each is vignettes[-1] for each in vignettes)
    assert np.isfinite(status.rmse)
