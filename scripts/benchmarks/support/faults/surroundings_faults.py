# SPDX-License-Identifier: BSD-3-Clause
"""What happens around the robot: covers, hands, darkness, lamps."""

import itertools
from typing import Any, Callable, Dict, Iterable

import cv2
import numpy as np
from support.faults.camera_faults import always, black, during
from support.faults.drive import LONGEST_S, Picture
from support.faults.live import Live
from support.faults.outcome import Fault

GROUP = "surroundings"
BLIND = "camera"


def covered(picture: Picture) -> Picture:
    """A cloth over the lens: a blurred glow, the same wherever the robot is."""
    glow = np.outer(np.hanning(picture.pixels.shape[0]), np.hanning(picture.pixels.shape[1]))
    return picture.showing(8.0 + 6.0 * glow + np.random.default_rng(picture.pixels[0, 0]).normal(0, 1, glow.shape))


class Hand:
    """A hand's shadow that wanders over most of the image."""

    def __init__(self) -> None:
        self._numbers = itertools.count()

    def __call__(self, picture: Picture) -> Picture:
        """See the class."""
        number = next(self._numbers)
        height, width = picture.pixels.shape
        mask: Any = np.zeros((height, width), np.uint8)
        centre = (int(width * (0.35 + 0.25 * np.sin(0.3 * number))), int(height * (0.5 + 0.2 * np.cos(0.23 * number))))
        cv2.ellipse(mask, (centre, (2 * (width // 3), 2 * (height // 2)), 20.0), (255.0,), -1)
        for finger in range(4):
            tip = (centre[0] + width // 3, centre[1] - height // 3 + finger * height // 5)
            cv2.line(mask, centre, tip, (255.0,), height // 9)
        share = cv2.GaussianBlur(mask, (0, 0), 4.0) / 255.0
        return picture.showing(picture.pixels * (1.0 - share) + 25.0 * share)


def one_lamp(picture: Picture) -> Picture:
    """All is dark but for what is brightest."""
    bright = np.maximum(picture.pixels.astype(float) - 180.0, 0.0)
    return picture.showing(3.0 + 3.0 * bright)


class Dimmed:
    """All lamps give a share of their light."""

    def __init__(self, share: float) -> None:
        self._share = share

    def __call__(self, picture: Picture) -> Picture:
        """See the class."""
        return picture.showing(np.rint(picture.pixels * self._share))


def lamps_toggle(live: Live) -> None:
    """Half of the light goes off and on every 0.7 s."""
    for share in (0.45, 1.0) * 4:
        during(0.7, always(Dimmed(share)))(live)


def half_of_the_lamps(live: Live) -> None:
    """The light of one half of the image goes off at once."""

    def hook(picture: Picture) -> Iterable[Picture]:
        light = np.where(np.arange(picture.pixels.shape[1]) < picture.pixels.shape[1] // 2, 0.4, 1.0)
        return [picture.showing(picture.pixels * light)]

    during(3.0, hook)(live)


EVENT_S = 12.0
assert EVENT_S < LONGEST_S


def until_event_is_over(end_s: float) -> Callable[[Live], None]:
    """Script that drives until an event of the simulator is over."""

    def script(live: Live) -> None:
        while live.robot.driven_s < end_s:
            live.drive(0.05)

    return script


FAULTS: Dict[str, Fault] = {
    "covered": Fault(
        GROUP,
        "a cloth lies on the lens for 4 s",
        during(4.0, always(covered)),
        BLIND,
        1.0,
        is_blind=True,
        losses=1,
        recovers_s=12.0,
    ),
    "dark": Fault(
        GROUP, "it is dark for 4 s", during(4.0, always(black)), BLIND, 1.0, is_blind=True, losses=1, recovers_s=12.0
    ),
    "dark_briefly": Fault(GROUP, "it is dark for 0.6 s", during(0.6, always(black))),
    "one_lamp": Fault(
        GROUP,
        "only the brightest lamps are seen for 3 s",
        during(3.0, always(one_lamp)),
        is_blind=True,
        losses=1,
        recovers_s=12.0,
    ),
    "hand": Fault(
        GROUP,
        "a hand over half of the lens for 3 s",
        during(3.0, always(Hand())),
        is_blind=True,
        losses=1,
        recovers_s=12.0,
    ),
    "lamps_off": Fault(
        GROUP, "all lamps at 40 % from one image to the next, for 3 s", during(3.0, always(Dimmed(0.4)))
    ),
    "lamps_toggle": Fault(GROUP, "the lamps go to 45 % and back every 0.7 s", lamps_toggle),
    "half_of_the_lamps": Fault(
        GROUP,
        "the lamps of one half of the hall go to 40 % for 3 s",
        half_of_the_lamps,
        is_blind=True,
        losses=1,
        recovers_s=12.0,
    ),
    "lights_slowly": Fault(
        GROUP,
        "lamps off and on with an exposure that follows slowly",
        until_event_is_over(EVENT_S + 5.0),
        events=(f"lights_off@{EVENT_S:g}+0.1", f"lights_on@{EVENT_S + 3.0:g}+0.1"),
        is_blind=True,
        losses=1,
        recovers_s=12.0,
    ),
    "flicker": Fault(
        GROUP, "the lamps flicker for 4 s", until_event_is_over(EVENT_S + 4.5), events=(f"flicker@{EVENT_S:g}+4",)
    ),
    "bump": Fault(
        GROUP, "the robot drives over a cable", until_event_is_over(EVENT_S + 1.0), events=(f"bump@{EVENT_S:g}",)
    ),
}
