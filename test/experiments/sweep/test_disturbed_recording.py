# SPDX-License-Identifier: BSD-3-Clause
"""Parts of a recording, and disturbances that nothing but the seed and the image's number decide."""

from dataclasses import replace

import numpy as np
import pytest

from ceiling_dso_ros.experiments.sweep.conditions import Conditions
from ceiling_dso_ros.experiments.sweep.disturbed_recording import DisturbedRecording
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.recording import ImageTimes, ListedImage, WheelSamples, WheelUnit
from ceiling_dso_ros.io.recording_view import RecordingPart

COUNT, PERIOD_NS, START_NS = 400, 50_000_000, 7_000_000_000


class Images:
    """20 images a second, and wheels."""

    path = calibration = photometric = robot = ground_truth_path = None
    uses_exposures = True
    grey = np.uint8(100)

    def __len__(self):
        return COUNT

    def images(self):
        for index in range(COUNT):
            stamp_ns = START_NS + index * PERIOD_NS
            yield ListedImage(stamp_ns, 5.0, f"{index}", lambda: np.full((40, 60), self.grey))

    def image_times(self):
        return ImageTimes(START_NS, START_NS + (COUNT - 1) * PERIOD_NS)

    @property
    def wheels(self):
        stamps_ns = START_NS + np.arange(0, 20_000_000_000, 10_000_000)
        return WheelSamples(WheelUnit.TICKS, stamps_ns, np.zeros((len(stamps_ns), 2), np.int64))


def disturbed(seed=0, **conditions):
    return [*DisturbedRecording(Images(), Conditions(**conditions), seed).images()]


def test_without_disturbances_nothing_changes():
    for before, after in zip(Images().images(), disturbed()):
        assert (after.stamp_ns, after.exposure_ms, after.name) == (before.stamp_ns, before.exposure_ms, before.name)
        np.testing.assert_array_equal(after.decode(), before.decode())


def test_images_are_lost():
    names = [image.name for image in disturbed(drop=0.25)]
    assert 0.2 < 1.0 - len(names) / COUNT < 0.3
    assert names == [image.name for image in disturbed(drop=0.25)]
    assert names != [image.name for image in disturbed(drop=0.25, seed=1)]


def test_noise_is_that_of_the_image_whatever_else_is_read():
    images = disturbed(noise=4.0)
    late = images[300].decode()
    assert 3.5 < late.std() < 4.5
    assert abs(late.mean() - 100.0) < 0.5
    again = [image.decode() for image in disturbed(noise=4.0)]
    np.testing.assert_array_equal(again[300], late)
    assert (images[301].decode() != late).any()


def test_brightness_and_exposure_time_go_together():
    images = disturbed(exposure=0.5)
    grey = np.array([image.decode().mean() for image in images])
    assert 145.0 < grey.max() <= 150.0
    assert 66.0 <= grey.min() < 70.0
    np.testing.assert_allclose([image.exposure_ms for image in images], 5.0 * grey / 100.0, atol=0.03)
    assert np.abs(np.diff(grey)).max() < 3.0


def test_stamps_are_a_little_wrong():
    errors_ns = np.subtract([image.stamp_ns for image in disturbed(stamp_jitter=0.01)],
                            [image.stamp_ns for image in Images().images()])  # fmt: skip
    assert 8e6 < errors_ns.std() < 12e6


def test_blur():
    class Edge(Images):
        def images(self):
            image = np.zeros((40, 60), np.uint8)
            image[:, 30:] = 200
            yield ListedImage(0, None, "edge", lambda: image)

    (blurred,) = DisturbedRecording(Edge(), Conditions(blur=2.0), 0).images()
    assert np.abs(np.diff(blurred.decode()[20].astype(int))).max() < 60
    assert blurred.exposure_ms is None


def test_noise_needs_8_bits():
    recording = Images()
    recording.grey = np.uint16(1000)
    with pytest.raises(FrameError, match="only one with 8 bits"):
        next(DisturbedRecording(recording, Conditions(noise=1.0), 0).images()).decode()


def test_a_part_has_its_images_and_wheels():
    part = RecordingPart(Images(), start_s=2.0, duration_s=3.0, skip=4)
    names = [int(image.name) for image in part.images()]
    assert (names[0], names[-1]) == (44, 100)
    times = part.image_times()
    assert (times.first_ns, times.last_ns) == (START_NS + 2_000_000_000, START_NS + 5_000_000_000)
    stamps_ns = part.wheels.stamps_ns
    assert (stamps_ns[0], stamps_ns[-1]) == (times.first_ns, times.last_ns)
    assert len(part.wheels.readings) == len(stamps_ns)
    assert RecordingPart(Images(), start_s=100.0).wheels is None


def test_one_wrong_stamp_does_not_end_a_part():
    class Ahead(Images):
        def images(self):
            for index, image in enumerate(super().images()):
                yield replace(image, stamp_ns=image.stamp_ns + (3_600_000_000_000 if index == 50 else 0))

    assert len([*RecordingPart(Ahead()).images()]) == COUNT
    assert len([*RecordingPart(Ahead(), duration_s=5.0).images()]) == 100


def test_the_whole_is_a_part():
    part = RecordingPart(Images())
    assert len([*part.images()]) == COUNT
    assert part.image_times() == Images().image_times()
