# SPDX-License-Identifier: BSD-3-Clause
"""Faults of the wheels and their encoders."""

import itertools
from dataclasses import replace
from typing import Callable, Dict, Iterable, List, Optional

import numpy as np
import rospy
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from support.faults.camera_faults import always, black
from support.faults.drive import Angles
from support.faults.live import Live
from support.faults.outcome import Fault
from support.faults.robot import silent

GROUP = "wheels"
SILENCE_GAP_S = 0.75  # after 0.5 s without a sample the camera goes on alone, with its next image


def during(seconds: float, hook: Callable[[Angles], Iterable[Angles]]) -> Callable[[Live], None]:
    """Script with a hook on the wheels."""

    def script(live: Live) -> None:
        with live.robot.wheels(hook):
            live.drive(seconds)

    return script


def stuck(*sides: int) -> Callable[[Live], None]:
    """Script: encoders of some wheels (0 left, 1 right) say the same for 3 s, and then go on from there."""

    def script(live: Live) -> None:
        stuck_at: List[np.ndarray] = []
        lost = np.zeros(2)

        def hold(angles: Angles) -> Iterable[Angles]:
            stuck_at[:] = stuck_at or [angles.radians.copy()]
            held = angles.radians.copy()
            held[list(sides)] = stuck_at[0][list(sides)]
            lost[:] = angles.radians - held
            return [replace(angles, radians=held)]

        during(3.0, hold)(live)
        live.robot.keep_wheels(lambda angles: [replace(angles, radians=angles.radians - lost)])

    return script


def sticking(live: Live) -> None:
    """For 6 s the encoders say the same for 0.3 s of every 0.7 s, and then what they have counted."""
    kept: Dict[int, np.ndarray] = {}

    def hold(angles: Angles) -> Iterable[Angles]:
        period, within_s = divmod(angles.time_s, 0.7)
        held = kept.setdefault(int(period), angles.radians.copy())
        return [replace(angles, radians=held if within_s < 0.3 else angles.radians)]

    during(6.0, hold)(live)


def delayed_in_the_dark(live: Live) -> None:
    """While the camera sees nothing, the wheels' samples of 1 s come all at once at its end."""
    held: List[Angles] = []

    def hold(angles: Angles) -> Iterable[Angles]:
        held.append(angles)
        return []

    def release(angles: Angles) -> Iterable[Angles]:
        released, held[:] = [*held, angles], []
        return released

    with live.robot.camera(always(black)):
        live.drive(1.6)
        during(1.0, hold)(live)
        with live.robot.wheels(release):
            live.drive(0.5)


def slipping(live: Live) -> None:
    """The left wheel turns 2 rad/s faster than it rolls for 1 s, then both go on."""
    extra = np.zeros(2)

    def slip(angles: Angles) -> Iterable[Angles]:
        extra[0] += 5.0 / 50.0
        return [replace(angles, radians=angles.radians + extra)]

    during(1.0, slip)(live)
    live.robot.keep_wheels(lambda angles: [replace(angles, radians=angles.radians + extra)])


def against_a_wall(live: Live) -> None:
    """The robot stands, its wheels turn."""
    extra = np.zeros(2)

    def spin(angles: Angles) -> Iterable[Angles]:
        extra[:] += 6.0 / 50.0
        return [replace(angles, radians=angles.radians + extra)]

    live.robot.standing = True
    live.drive(0.3)
    during(1.5, spin)(live)
    live.robot.keep_wheels(lambda angles: [replace(angles, radians=angles.radians + extra)])
    live.drive(0.5)
    live.robot.standing = False


def standing(live: Live) -> None:
    """The robot stands for 5 s, nothing else."""
    live.robot.standing = True
    live.drive(5.0)
    live.robot.standing = False


def restarted_encoders(live: Live) -> None:
    """The angles begin again at 0."""
    origin: List[np.ndarray] = []

    def hook(angles: Angles) -> Iterable[Angles]:
        origin[:] = origin or [angles.radians.copy()]
        return [replace(angles, radians=angles.radians - origin[0])]

    live.robot.keep_wheels(hook)
    live.drive(2.0)


def rarely(live: Live) -> None:
    """Ten samples a second."""
    numbers = itertools.count()
    during(5.0, lambda angles: [angles] if next(numbers) % 5 == 0 else [])(live)


def often(live: Live) -> None:
    """Two hundred samples a second, in packets of four."""
    last: List[Angles] = []

    def hook(angles: Angles) -> Iterable[Angles]:
        before: Optional[Angles] = last[0] if last else None
        last[:] = [angles]
        if before is None:
            return [angles]
        shares = (0.25, 0.5, 0.75, 1.0)
        return [
            replace(
                angles,
                time_s=before.time_s + share * (angles.time_s - before.time_s),
                radians=before.radians + share * (angles.radians - before.radians),
            )
            for share in shares
        ]

    during(5.0, hook)(live)


def burst(live: Live) -> None:
    """Samples of half a second arrive at once."""
    held: List[Angles] = []

    def hold(angles: Angles) -> Iterable[Angles]:
        held.append(angles)
        return ()

    during(0.4, hold)(live)

    def release(angles: Angles) -> Iterable[Angles]:
        together, held[:] = [*held, angles], []
        return together

    during(1.0, release)(live)


def not_numbers(live: Live) -> None:
    """Angles that are no numbers, among good ones."""
    values = itertools.cycle(([np.nan, 0.0], [0.0, np.inf], None, None, None, None))

    def hook(angles: Angles) -> Iterable[Angles]:
        value = next(values)
        return [angles if value is None else replace(angles, radians=np.array(value))]

    during(2.0, hook)(live)


def foreign_odometry(live: Live) -> None:
    """Somebody else publishes nonsense on wheel/odometry."""
    publisher = rospy.Publisher("wheel/odometry", Odometry, queue_size=10)
    for _ in range(10):
        publisher.publish(Odometry(header=Header(stamp=rospy.Time.now(), frame_id="odom")))
        live.drive(0.2)
    publisher.unregister()


FAULTS: Dict[str, Fault] = {
    "wheels_silent": Fault(
        GROUP, "no wheel sample for 2 s", during(2.0, silent), "silent|no wheel", 1.2, gap_s=SILENCE_GAP_S
    ),
    "wheel_stuck": Fault(GROUP, "the left encoder is stuck for 3 s", stuck(0), "wheels", 1.5),
    "wheels_stuck": Fault(GROUP, "both encoders are stuck for 3 s", stuck(0, 1), "wheels", 1.5),
    "wheels_stick": Fault(GROUP, "for 6 s both encoders stick and catch up, again and again", sticking),
    "wheels_late_in_the_dark": Fault(
        GROUP,
        "in the dark, the wheels' samples of 1 s come all at once",
        delayed_in_the_dark,
        "silent",
        3.0,
        gap_s=SILENCE_GAP_S,
        jump_rad=0.1,  # for half a second nothing tells of a turn that begins or ends
        is_blind=True,
        losses=1,
    ),
    "wheel_slips": Fault(GROUP, "the left wheel slips for 1 s, by 5 rad", slipping, "slip", 1.0),
    "against_a_wall": Fault(GROUP, "the robot stands, its wheels turn for 1.5 s", against_a_wall, "wheels", 1.0),
    "standing": Fault(GROUP, "the robot stands for 5 s, no fault", standing),
    "encoders_restart": Fault(GROUP, "the angles begin again at 0", restarted_encoders, "wheel|angle|motion"),
    "not_numbers": Fault(GROUP, "every third pair of angles is nan or inf for 2 s", not_numbers, "not finite"),
    "other_joints": Fault(
        GROUP,
        "for 1 s the messages have other joints",
        during(1.0, lambda a: [replace(a, names=("elbow", "wrist"))]),
        "joint|silent",
        1.2,
        gap_s=SILENCE_GAP_S,
    ),
    "twice": Fault(GROUP, "every sample comes twice for 3 s", during(3.0, lambda a: [a, a])),
    "ten_hertz": Fault(GROUP, "10 samples a second for 5 s", rarely),
    "two_hundred_hertz": Fault(GROUP, "200 samples a second, in packets of four, for 5 s", often),
    "wheels_burst": Fault(GROUP, "no sample for 0.4 s, then all of them at once", burst, gap_s=0.7),
    "no_wheel_stamp": Fault(
        GROUP, "for 0.4 s the samples have no stamp", during(0.4, lambda a: [replace(a, later_ns=-(2**62))]), "stamp"
    ),
    "foreign_odometry": Fault(GROUP, "somebody else sends zeros on wheel/odometry", foreign_odometry, "quaternion"),
}
