# SPDX-License-Identifier: BSD-3-Clause
"""Faults of the clocks."""

from dataclasses import replace
from typing import Callable, Dict, Iterable

from support.faults.drive import Picture
from support.faults.live import Live
from support.faults.outcome import Fault

from ceiling_dso_ros.dso.durations import nanoseconds

GROUP = "time"


def set_clock(shift_s: float) -> Callable[[Live], None]:
    """Script that sets the machine's clock: that of all processes of this benchmark."""

    def script(live: Live) -> None:
        assert live.clock is not None
        live.clock.shift(shift_s)
        live.drive(3.0)

    return script


def both_ways(live: Live) -> None:
    """A second back and forth, five times."""
    assert live.clock is not None
    for shift_s in (-1.0, 1.0) * 5:
        live.clock.shift(shift_s)
        live.drive(0.7)


def camera_clock(shift_s: float) -> Callable[[Live], None]:
    """Script that sets the clock of the camera alone, for 4 s."""

    def script(live: Live) -> None:
        with live.robot.camera(lambda picture: [replace(picture, later_ns=nanoseconds(shift_s))]):
            live.drive(4.0)

    return script


def wheel_clock(shift_s: float) -> Callable[[Live], None]:
    """Script that sets the clock of the wheels alone, for 4 s."""

    def script(live: Live) -> None:
        with live.robot.wheels(lambda angles: [replace(angles, later_ns=nanoseconds(shift_s))]):
            live.drive(4.0)

    return script


def played_again(live: Live) -> None:
    """The simulated time jumps back, as when a bag is played again."""
    live.robot.shift_simulated_clock(-100_000_000_000)
    live.drive(2.0)


def jumps_forward(live: Live) -> None:
    """The simulated time jumps forward, as when a part of a bag is left out."""
    live.robot.shift_simulated_clock(100_000_000_000)
    live.drive(2.0)


def paused(live: Live) -> None:
    """The simulated time stands still."""
    with live.robot.paused():
        live.drive(3.0)


def jitter(live: Live) -> None:
    """The stamps of the images err by up to 10 ms."""
    late_ns = [0, 7_000_000, -8_000_000, 10_000_000, -3_000_000]

    def hook(picture: Picture) -> Iterable[Picture]:
        late_ns.append(late_ns.pop(0))
        return [replace(picture, later_ns=late_ns[0])]

    with live.robot.camera(hook):
        live.drive(4.0)


FAULTS: Dict[str, Fault] = {
    "back_a_second": Fault(GROUP, "the machine's clock is set back by 1 s", set_clock(-1.0), shifted_clock=True),
    "back_150_ms": Fault(GROUP, "the machine's clock is set back by 0.15 s", set_clock(-0.15), shifted_clock=True),
    "back_an_hour": Fault(GROUP, "the machine's clock is set back by 1 h", set_clock(-3600.0), shifted_clock=True),
    "forward_a_second": Fault(GROUP, "the machine's clock is set forward by 1 s", set_clock(1.0), shifted_clock=True),
    "forward_an_hour": Fault(GROUP, "the machine's clock is set forward by 1 h", set_clock(3600.0), shifted_clock=True),
    "back_and_forth": Fault(
        GROUP, "the machine's clock: back and forth by 1 s, five times", both_ways, shifted_clock=True
    ),
    "camera_clock_back": Fault(
        GROUP,
        "the camera's clock alone is set back by 1 s for 4 s",
        camera_clock(-1.0),
        "camera|image",
        1.5,
        is_blind=True,
    ),
    "camera_clock_ahead": Fault(
        GROUP,
        "the camera's clock alone is set ahead by 0.3 s for 4 s",
        camera_clock(0.3),
        "clock of the images was set ahead",
        1.5,
        is_blind=True,
    ),
    "wheel_clock_back": Fault(
        GROUP,
        "the wheels' clock alone is set back by 0.3 s for 4 s",
        wheel_clock(-0.3),
        "clock of the wheels was set back",
        1.5,
        is_blind=True,
    ),
    "wheel_clock_ahead": Fault(
        GROUP,
        "the wheels' clock alone is set ahead by 0.3 s for 4 s",
        wheel_clock(0.3),
        "clock of the wheels was set ahead",
        1.5,
        is_blind=True,
    ),
    "jitter": Fault(GROUP, "the images' stamps err by up to 10 ms for 4 s", jitter),
    "played_again": Fault(
        GROUP,
        "the simulated time jumps back by 100 s",
        played_again,
        "back|again|restart",
        1.0,
        simulated_clock=True,
        begins_anew=True,
        recovers_s=15.0,
    ),
    "simulated_forward": Fault(
        GROUP,
        "the simulated time jumps forward by 100 s",
        jumps_forward,
        simulated_clock=True,
        recovers_s=15.0,
        is_blind=True,
        losses=1,
    ),
    "paused": Fault(GROUP, "the simulated time stands still for 3 s", paused, gap_s=3.5, simulated_clock=True),
}
