# SPDX-License-Identifier: BSD-3-Clause
"""Recordings that are seen otherwise than they were recorded: the base of all that change one, and a part of one."""

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Iterator, Optional

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.recording import (
    ImageTimes,
    ListedImage,
    Recording,
    RobotDescription,
    SecondCamera,
    WheelSamples,
)
from ceiling_dso_ros.io.stamps import NANOSECONDS

LONGEST_S = 1e6  # of a recording: eleven days


class RecordingView(Recording):
    """A recording as it is; subclasses change what they show of it."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.path = recording.path
        self.calibration = recording.calibration
        self.photometric = recording.photometric
        self.uses_exposures = recording.uses_exposures

    def __len__(self) -> int:
        return len(self._recording)

    def images(self) -> Iterator[ListedImage]:
        """See Recording."""
        return self._recording.images()

    def image_times(self) -> Optional[ImageTimes]:
        """See Recording."""
        return self._recording.image_times()

    @property
    def second_camera(self) -> Optional[SecondCamera]:
        """See Recording."""
        return self._recording.second_camera

    @property
    def wheels(self) -> Optional[WheelSamples]:
        """See Recording."""
        return self._recording.wheels

    @property
    def robot(self) -> Optional[RobotDescription]:
        """See Recording."""
        return self._recording.robot

    @property
    def ground_truth_path(self) -> Optional[Path]:
        """See Recording."""
        return self._recording.ground_truth_path


class RecordingPart(RecordingView):
    """The images and the wheels of a part of a recording."""

    def __init__(self, recording: Recording, start_s: float = 0.0, duration_s: float = 0.0, skip: int = 0) -> None:
        """Choose the part.

        Args:
            recording: the whole.
            start_s: its begin, seconds after the first image.
            duration_s: its length, seconds; 0 for all that follows.
            skip: number of further images that are left out at the begin.

        Raises:
            InputError: the recording has no images with stamps, or turns out to be damaged.
        """
        super().__init__(recording)
        times = recording.image_times()
        if times is None:
            raise InputError(f"{recording.path}: no image has a stamp, so that no part of it can be chosen")
        self._skip = skip
        self._is_whole = not start_s and not duration_s  # what is wrong with some stamps is then for others to say
        self._first_ns = times.first_ns + round(start_s * NANOSECONDS)
        end_ns = self._first_ns + round(duration_s * NANOSECONDS)
        self._last_ns = min(times.last_ns, end_ns) if duration_s else times.last_ns
        self._times = times

    def __len__(self) -> int:
        return len(self._recording) if self._is_whole else sum(1 for _ in self.images())

    @property
    def is_empty(self) -> bool:
        """Whether it begins after the last image."""
        return self._first_ns > self._times.last_ns

    def images(self) -> Iterator[ListedImage]:
        """See Recording; an image without a stamp belongs to a part if it is listed after its first."""
        images = self._recording.images() if self._is_whole else self._within()
        return islice(images, self._skip, None)

    def image_times(self) -> ImageTimes:
        """See Recording."""
        return replace(self._times, first_ns=self._first_ns, last_ns=max(self._first_ns, self._last_ns))

    @property
    def second_camera(self) -> Optional[SecondCamera]:
        """See Recording."""
        return self._recording.second_camera

    @property
    def wheels(self) -> Optional[WheelSamples]:
        """See Recording; None where the part has none."""
        wheels = self._recording.wheels
        if wheels is None or self._is_whole:
            return wheels
        chosen = (wheels.stamps_ns >= self._first_ns) & (wheels.stamps_ns <= self._last_ns)
        if not chosen.any():
            return None
        return replace(wheels, stamps_ns=wheels.stamps_ns[chosen], readings=wheels.readings[chosen])

    def _within(self) -> Iterator[ListedImage]:
        begun = False
        for listed in self._recording.images():
            if listed.stamp_ns is None:
                if begun:
                    yield listed
            elif self._first_ns <= listed.stamp_ns <= self._last_ns:
                begun = True
                yield listed
