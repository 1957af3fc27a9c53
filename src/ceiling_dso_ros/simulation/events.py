# SPDX-License-Identifier: BSD-3-Clause
"""Faults and disturbances, called events, that can be added to any sequence.

An event is written `NAME[@START][+DURATION]` in seconds; without a start it happens at the default times of its kind.
"""

import re
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np


@dataclass(frozen=True)
class Event:
    """Something that happens while the robot drives.

    Attributes:
        kind: one of KINDS.
        start_s: when it begins, seconds from the start of the sequence.
        duration_s: how long it lasts.
    """

    kind: str
    start_s: float
    duration_s: float

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.duration_s


@dataclass(frozen=True)
class Kind:
    """A kind of event.

    Attributes:
        starts: default start times as shares of the sequence's duration.
        duration_s: default duration.
        meaning: in words.
    """

    starts: Sequence[float]
    duration_s: float
    meaning: str


KINDS: Dict[str, Kind] = {
    "slip": Kind((0.25, 0.5, 0.75), 0.5, "the left wheel turns twice as far as it should"),
    "lights_off": Kind((0.4,), 0.3, "all lamps go out; the exposure follows slowly"),
    "lights_on": Kind((0.55,), 0.3, "the lamps go on again; without lights_off they are off until then"),
    "cover": Kind((0.45,), 5.0, "something covers the lens"),
    "bump": Kind((0.3, 0.6), 0.6, "the robot drives over a cable: it pitches and bounces"),
    "drop_frames": Kind((0.35,), 2.0, "most images are lost"),
    "flicker": Kind((0.3,), 5.0, "the lamps flicker at twice the mains frequency"),
    "kidnap": Kind((0.5,), 4.0, "the robot is carried elsewhere while its wheels go on with the plan"),
}
PATTERN = re.compile(r"(?P<kind>[a-z_]+)(@(?P<start>[0-9.]+))?(\+(?P<duration>[0-9.]+))?")


class EventError(ValueError):
    """A text does not describe an event; the message says what is expected."""


def parse_events(texts: Sequence[str], duration_s: float) -> List[Event]:
    """Events in the order of time.

    Args:
        texts: as described above.
        duration_s: of the sequence; inf if it has no end.

    Raises:
        EventError: a text is not an event, or the event begins after the end of the sequence.
    """
    events = []
    for text in texts:
        kind, start_s, length_s = _parse(text)
        starts = [share * duration_s for share in KINDS[kind].starts] if start_s is None else [start_s]
        if not starts[-1] < duration_s:
            when = f"begin within the {duration_s:.1f} s of the sequence" if np.isfinite(duration_s) else "say @START"
            raise EventError(f"'{text}': must {when}")
        events += [Event(kind, start, length_s) for start in starts]
    return sorted(events, key=lambda event: event.start_s)


def parse_live_event(text: str, now_s: float, events: Sequence[Event]) -> Event:
    """An event while a drive goes on: now if it says no start.

    Args:
        text: the event.
        now_s: seconds since the start of the drive.
        events: those that there are already.

    Raises:
        EventError: the text is no event, the event would be in the past, or lamps that are on would go on.
    """
    kind, start_s, length_s = _parse(text.strip())
    event = Event(kind, now_s if start_s is None else start_s, length_s)
    if event.start_s < now_s:
        raise EventError(f"'{text}': that is over, the drive has lasted for {now_s:.1f} s")
    if event.kind == "lights_on" and light_level(events, np.array([event.start_s]))[0] == 1.0:
        raise EventError(f"'{text}': the lamps are on")
    return event


def _parse(text: str) -> Tuple[str, Optional[float], float]:
    """Kind, start if the text says it, and duration."""
    match = PATTERN.fullmatch(text)
    if match is None or match["kind"] not in KINDS:
        raise EventError(f"'{text}' is not an event; write NAME[@START][+DURATION] with NAME one of {', '.join(KINDS)}")
    try:
        start_s = float(match["start"]) if match["start"] else None
        length_s = float(match["duration"]) if match["duration"] else KINDS[match["kind"]].duration_s
    except ValueError:
        raise EventError(f"'{text}': start and duration must be seconds") from None
    if length_s <= 0.0:
        raise EventError(f"'{text}': must last longer than 0 s")
    return match["kind"], start_s, length_s


def of_kind(events: Sequence[Event], kind: str) -> List[Event]:
    """The events of one kind."""
    return [event for event in events if event.kind == kind]


SLIP = 0.5  # share of a slipping wheel's rotation that does not move the robot


def slip_share(events: Sequence[Event], time_s: np.ndarray) -> np.ndarray:
    """Share of the left wheel's rotation that is lost by slipping, (N,) of (N,) times."""
    share = np.zeros(len(time_s))
    for event in of_kind(events, "slip"):
        share[(time_s >= event.start_s) & (time_s < event.end_s)] = SLIP
    return share


LIGHTS_OFF_LEVEL = 0.12
FLICKER_HZ, FLICKER_DEPTH = 100.0, 0.25


def light_level(events: Sequence[Event], time_s: np.ndarray) -> np.ndarray:
    """Light as a share of the normal light, (N,) of (N,) times, without flicker."""
    switches = [event for event in events if event.kind in ("lights_off", "lights_on")]
    level = np.full(len(time_s), LIGHTS_OFF_LEVEL if switches and switches[0].kind == "lights_on" else 1.0)
    for event in switches:
        target = LIGHTS_OFF_LEVEL if event.kind == "lights_off" else 1.0
        share = np.clip((time_s - event.start_s) / event.duration_s, 0.0, 1.0)
        level = (1.0 - share) * level + share * target
    return level


def flicker_factor(events: Sequence[Event], time_s: float, exposure_s: float) -> float:
    """Mean of the flickering light over an exposure around time_s, as a share of the steady light."""
    if not any(event.start_s <= time_s < event.end_s for event in of_kind(events, "flicker")):
        return 1.0
    blur = np.sinc(FLICKER_HZ * exposure_s)
    return float(1.0 + FLICKER_DEPTH * blur * np.sin(2 * np.pi * FLICKER_HZ * time_s))


DROPPED_SHARE = 0.8


def is_dropped(events: Sequence[Event], time_s: float, rng: np.random.Generator) -> bool:
    """Whether an image is lost."""
    during = any(event.start_s <= time_s < event.end_s for event in of_kind(events, "drop_frames"))
    return bool(during and rng.random() < DROPPED_SHARE)


COVER_SLIDE_S = 0.2
COVER_EDGE_PX = 25.0
COVER_LIGHT = 0.02  # light that passes through the cover, as a share of saturation


def covered_light(events: Sequence[Event], time_s: float, light: np.ndarray) -> np.ndarray:
    """The light (H, W) that reaches the camera when something covers its lens."""
    mask = _cover_mask(events, time_s, light.shape[1])
    return light * mask + np.float32(COVER_LIGHT) * (1.0 - mask)


def _cover_mask(events: Sequence[Event], time_s: float, width: int) -> np.ndarray:
    """Share of the light that reaches each column, (width,) float32; a cover slides in and out from left to right."""
    passed = np.ones(width, dtype=np.float32)
    for event in of_kind(events, "cover"):
        reach = width + 4 * COVER_EDGE_PX
        front = (time_s - event.start_s) / COVER_SLIDE_S * reach - 2 * COVER_EDGE_PX
        back = (time_s - event.end_s) / COVER_SLIDE_S * reach - 2 * COVER_EDGE_PX
        x = np.arange(width)
        covered = _step((front - x) / COVER_EDGE_PX) * (1.0 - _step((back - x) / COVER_EDGE_PX))
        passed *= (1.0 - covered).astype(np.float32)
    return passed


def _step(x: np.ndarray) -> np.ndarray:
    return np.clip(0.5 + 0.5 * x, 0.0, 1.0)
