# SPDX-License-Identifier: BSD-3-Clause
"""Faults of the camera, its exposure times, its calibration and its mount."""

import itertools
from dataclasses import replace
from typing import Callable, Dict, Iterable, List

import numpy as np
from support.faults.drive import Picture
from support.faults.live import Live
from support.faults.outcome import Fault
from support.faults.robot import replace_header, silent, with_exposure

Falsify = Callable[[Picture], Picture]
GROUP = "camera"
# A map is kept for a second without an image; how far the robot has come by then, the wheels know.
WITH_PREDICTION = {"motion_prediction": "true"}
NOISE = np.random.default_rng(1)


def every(count: int, falsify: Falsify) -> Callable[[Picture], Iterable[Picture]]:
    """Hook that falsifies the first of so many pictures."""
    numbers = itertools.count()
    return lambda picture: [falsify(picture) if next(numbers) % count == 0 else picture]


def always(falsify: Falsify) -> Callable[[Picture], Iterable[Picture]]:
    """Hook that falsifies every picture."""
    return lambda picture: [falsify(picture)]


def during(seconds: float, hook: Callable[[Picture], Iterable[Picture]]) -> Callable[[Live], None]:
    """Script with a hook on the camera."""

    def script(live: Live) -> None:
        with live.robot.camera(hook):
            live.drive(seconds)

    return script


def once(count: int, falsify: Falsify, seconds: float = 2.0) -> Callable[[Live], None]:
    """Script that falsifies so many pictures in a row."""

    def script(live: Live) -> None:
        left = itertools.chain(range(count))

        def hook(picture: Picture) -> Iterable[Picture]:
            return [falsify(picture) if next(left, None) is not None else picture]

        during(seconds, hook)(live)

    return script


def white(picture: Picture) -> Picture:
    """Saturated."""
    return picture.showing(np.full(picture.pixels.shape, 255))


def black(picture: Picture) -> Picture:
    """Dark, with the sensor's noise."""
    return picture.showing(np.abs(NOISE.normal(0.0, 1.5, picture.pixels.shape)))


def noise(picture: Picture) -> Picture:
    """Nothing but noise."""
    return picture.showing(NOISE.uniform(0.0, 255.0, picture.pixels.shape))


class Torn:
    """The lower part of a picture is that of one several pictures earlier."""

    def __init__(self) -> None:
        self._earlier: List[np.ndarray] = []

    def __call__(self, picture: Picture) -> Picture:
        """See the class."""
        self._earlier = [*self._earlier, picture.pixels][-6:]
        pixels = picture.pixels.copy()
        pixels[pixels.shape[0] // 2 :] = self._earlier[0][pixels.shape[0] // 2 :]
        return picture.showing(pixels)


class Frozen:
    """The first picture again and again, with new stamps."""

    def __init__(self) -> None:
        self._pixels = np.zeros(0)

    def __call__(self, picture: Picture) -> Picture:
        """See the class."""
        if not self._pixels.size:
            self._pixels = picture.pixels
        return picture.showing(self._pixels)


def torn_pictures(live: Live) -> None:
    """Every tenth picture is torn."""
    torn, numbers = Torn(), itertools.count(1)

    def hook(picture: Picture) -> Iterable[Picture]:
        damaged = torn(picture)
        return [damaged if next(numbers) % 10 == 0 else picture]

    during(4.0, hook)(live)


def out_of_order(live: Live) -> None:
    """One picture is stamped a millisecond before the last one."""
    period_ns = round(1e9 / 15)
    once(1, lambda picture: replace(picture, later_ns=-period_ns - 1_000_000))(live)


def slow(live: Live) -> None:
    """Three pictures a second."""
    numbers = itertools.count()
    during(6.0, lambda picture: [picture] if next(numbers) % 5 == 0 else [])(live)


def burst(live: Live) -> None:
    """Pictures of nearly a second arrive at once."""
    held: List[Picture] = []

    def hold(picture: Picture) -> Iterable[Picture]:
        held.append(picture)
        return ()

    during(0.9, hold)(live)

    def release(picture: Picture) -> Iterable[Picture]:
        together, held[:] = [*held, picture], []
        return together

    during(1.0, release)(live)


def late(live: Live) -> None:
    """Every picture arrives 0.3 s late."""
    waiting: List[Picture] = []

    def hook(picture: Picture) -> Iterable[Picture]:
        waiting.append(picture)
        due = [one for one in waiting if one.time_s <= picture.time_s - 0.3]
        waiting[:] = waiting[len(due) :]
        return due

    during(4.0, hook)(live)


def no_exposures(live: Live) -> None:
    """The exposures stop, while their publisher lives on."""
    during(4.0, always(lambda picture: with_exposure(picture, None)))(live)


def wrong_exposures(live: Live) -> None:
    """Exposures that cannot be."""
    values = itertools.cycle((float("nan"), 0.0, -3.0, float("inf")))
    during(3.0, always(lambda picture: with_exposure(picture, next(values))))(live)


def nonsense_info(live: Live) -> None:
    """A camera_info of zeros."""
    live.robot.publishes_info = False
    for _ in range(10):
        info = replace_header(live.robot.camera_info, live.robot.camera_info.header)
        info.K = [0.0] * 9
        live.robot.send_info(info)
        live.drive(0.2)
    live.robot.publishes_info = True


def other_size(live: Live) -> None:
    """camera_info says another image size."""
    live.robot.publishes_info = False
    for _ in range(10):
        info = replace_header(live.robot.camera_info, live.robot.camera_info.header)
        info.width, info.height = 640, 480
        live.robot.send_info(info)
        live.drive(0.2)
    live.robot.publishes_info = True


def late_info(live: Live) -> None:
    """camera_info comes 3 s after the first image."""
    live.robot.publishes_info = False
    live.drive(3.0)
    live.robot.publishes_info = True


def late_mount(live: Live) -> None:
    """The mount comes by /tf_static while the robot drives."""
    live.drive(4.0)
    live.robot.send_mount()


def another_mount(live: Live) -> None:
    """Somebody else says that the camera sits elsewhere."""
    moved = np.eye(4)
    moved[:3, 3] = (1.0, 0.0, 0.0)
    live.robot.send_mount(moved)
    live.drive(2.0)


NO_POSE = "no pose|cannot be tracked|not tracked|retry|no texture|saturated|dark|uniform|lost"
FAULTS: Dict[str, Fault] = {
    "nothing": Fault(GROUP, "nothing: the same drive without a fault", lambda live: live.drive(4.0)),
    "frozen": Fault(
        GROUP,
        "the driver repeats its last image with new stamps for 4 s",
        during(4.0, always(Frozen())),
        "repeats its last images",
        0.5,
        is_blind=True,
        losses=1,
    ),
    "silent": Fault(GROUP, "no image for 3 s", during(3.0, silent), "silent|no image", 1.2, is_blind=True, losses=1),
    "flash": Fault(GROUP, "one white image", once(1, white), "", 1.0),
    "flashes": Fault(GROUP, "white images for 0.5 s", once(8, white), "", 1.0),
    "black": Fault(GROUP, "one black image", once(1, black)),
    "noise": Fault(GROUP, "one image of noise", once(1, noise)),
    "torn": Fault(GROUP, "every tenth image torn, the lower half 0.3 s old, for 4 s", torn_pictures),
    "wrong_size": Fault(
        GROUP,
        "one image of another size",
        once(1, lambda p: replace(p, pixels=p.pixels[:100].copy())),
        "calibration is for",
    ),
    "wrong_encoding": Fault(
        GROUP,
        "images of an unknown encoding for 0.9 s",
        once(13, lambda p: replace(p, encoding="8UC7")),
        "8UC7",
        arguments=WITH_PREDICTION,
    ),
    "truncated": Fault(
        GROUP, "one image without half of its data", once(1, lambda p: replace(p, missing_bytes=50000)), "byte"
    ),
    "out_of_order": Fault(GROUP, "one image stamped 1 ms before the last one", out_of_order, "stamp"),
    "no_stamp": Fault(GROUP, "one image without a stamp", once(1, lambda p: replace(p, later_ns=-(2**62))), "no stamp"),
    "three_hertz": Fault(GROUP, "3 images a second for 6 s", slow, arguments=WITH_PREDICTION),
    "burst": Fault(GROUP, "no image for 0.9 s, then all of them at once", burst, arguments=WITH_PREDICTION),
    "late": Fault(GROUP, "images arrive 0.3 s late for 4 s", late),
    "exposure_missing": Fault(
        GROUP, "one exposure of fifty is missing", during(6.0, every(50, lambda p: with_exposure(p, None)))
    ),
    "exposures_silent": Fault(GROUP, "the exposures stop for 4 s", no_exposures, "too late or not at all", 3.0),
    "exposures_wrong": Fault(GROUP, "exposures that are nan, 0, -3 ms, inf for 3 s", wrong_exposures),
    "info_of_zeros": Fault(GROUP, "camera_info of zeros for 2 s", nonsense_info, "camera_info|focal|calibration"),
    "info_of_another_size": Fault(
        GROUP, "camera_info of another size for 2 s", other_size, "camera_info|calibration|size"
    ),
    "info_late": Fault(
        GROUP,
        "camera_info comes 3 s after the first image",
        late_info,
        "waiting for a calibration",
        is_blind=True,
        at_start=True,
        recovers_s=15.0,
    ),
    "mount_late": Fault(
        GROUP,
        "the camera's mount comes by tf 4 s into the drive",
        late_mount,
        "the camera is not used",
        1.0,
        is_blind=True,
        at_start=True,
        recovers_s=15.0,
        mount=False,
    ),
    "mount_moves": Fault(GROUP, "tf says another mount, 1 m off", another_mount),
}
