# SPDX-License-Identifier: BSD-3-Clause
"""A recording with disturbances that depend on nothing but a seed and the number of the image."""

from dataclasses import replace
from functools import partial
from typing import Iterator

import cv2
import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.experiments.sweep.conditions import Conditions
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.recording import ListedImage, Recording
from ceiling_dso_ros.io.recording_view import RecordingView
from ceiling_dso_ros.io.stamps import NANOSECONDS

EXPOSURE_PERIOD_S = 7.0
WHITE = 255.0


class DisturbedRecording(RecordingView):
    """Images are lost, noisy, blurred, brighter and darker, and stamped a little late or early."""

    def __init__(self, recording: Recording, conditions: Conditions, seed: int) -> None:
        """Take the recording; images with more than 8 bits cannot be made noisy or brighter."""
        super().__init__(recording)
        self._conditions, self._seed = conditions, seed

    def images(self) -> Iterator[ListedImage]:
        """See Recording."""
        conditions, first_ns = self._conditions, None
        phase = np.random.default_rng([self._seed, 1]).uniform(0.0, 2.0 * np.pi)
        for number, listed in enumerate(self._recording.images()):
            rng = np.random.default_rng([self._seed, 0, number])
            lost, late_s = rng.uniform() < conditions.drop, conditions.stamp_jitter * rng.normal()
            if lost:
                continue
            gain, stamp_ns = 1.0, listed.stamp_ns
            if stamp_ns is not None:
                first_ns = stamp_ns if first_ns is None else first_ns
                turn = 2.0 * np.pi * seconds(stamp_ns - first_ns) / EXPOSURE_PERIOD_S
                gain = float((1.0 + conditions.exposure) ** np.sin(turn + phase))
                stamp_ns = max(0, stamp_ns + round(late_s * NANOSECONDS))
            yield replace(
                listed,
                stamp_ns=stamp_ns,
                exposure_ms=None if listed.exposure_ms is None else gain * listed.exposure_ms,
                decode=partial(self._disturbed, listed, gain, rng),
            )

    def _disturbed(self, listed: ListedImage, gain: float, rng: np.random.Generator) -> np.ndarray:
        image, conditions = listed.decode(), self._conditions
        if image.dtype != np.uint8 and (gain != 1.0 or conditions.noise):
            raise FrameError(f"an image of {image.dtype} cannot be made noisy or brighter, only one with 8 bits")
        if conditions.blur:
            image = cv2.GaussianBlur(image, (0, 0), conditions.blur)
        if gain != 1.0 or conditions.noise:
            grey = gain * image + conditions.noise * rng.standard_normal(image.shape, np.float32)
            image = np.clip(np.rint(grey), 0.0, WHITE).astype(np.uint8)
        return image
