# SPDX-License-Identifier: BSD-3-Clause
import threading

from ceiling_dso_ros.ros.exposures import PATIENCE, ExposureLookup


def test_exposure_of_the_same_stamp_and_of_no_other():
    exposures = ExposureLookup()
    for stamp_ns, exposure_ms in [(10, 1.0), (20, None), (30, 3.0)]:
        exposures.add(stamp_ns, exposure_ms)
    assert [exposures.at(stamp_ns, 0.0) for stamp_ns in (9, 10, 20, 25, 30, 31)] == [None, 1.0, None, None, 3.0, None]


def test_unknown_without_exposures():
    assert ExposureLookup().at(10, 0.0) is None


def test_image_waits_for_its_exposure():
    exposures = ExposureLookup()
    exposures.add(10, 1.0)
    thread = threading.Timer(0.05, exposures.add, [20, 2.0])
    thread.start()
    assert exposures.at(20, 60.0) == 2.0
    thread.join()


def test_an_unknown_exposure_is_not_waited_for():
    exposures = ExposureLookup()
    exposures.add(10, None)
    assert exposures.at(10, 1e6) is None


def test_time_that_goes_backwards_forgets():
    exposures = ExposureLookup()
    exposures.add(30, 3.0)
    exposures.add(10, 1.0)
    assert exposures.at(10, 0.0) == 1.0
    assert exposures.at(30, 0.0) is None


def test_only_the_last_ones_are_kept():
    exposures = ExposureLookup(length=2)
    for stamp_ns in (10, 20, 30):
        exposures.add(stamp_ns, float(stamp_ns))
    assert [exposures.at(stamp_ns, 0.0) for stamp_ns in (10, 20)] == [None, 20.0]


class Silent:
    """A connected publisher that says nothing: who waits for it waits until the time is over, which a clock counts."""

    def __init__(self):
        self.now_s = 100.0
        self.waits = 0
        self.exposures = ExposureLookup(monotonic_s=lambda: self.now_s, wait=self.wait)

    def wait(self, predicate, timeout_s):
        if timeout_s > 0.0 and not predicate():
            self.waits += 1
            self.now_s += timeout_s
        return predicate()

    def image(self, stamp_ns):
        return self.exposures.at(stamp_ns, 0.05)


def test_images_stop_waiting_for_a_publisher_that_is_silent():
    silent = Silent()
    for stamp_ns in range(10, 40):
        assert silent.image(stamp_ns) is None
    assert silent.waits == PATIENCE
    assert silent.exposures.is_late


def test_they_wait_again_when_exposures_come_again():
    silent = Silent()
    for stamp_ns in range(10, 40):
        silent.image(stamp_ns)
    silent.exposures.add(40, 4.0)  # sooner than its image
    assert not silent.exposures.is_late
    assert silent.image(40) == 4.0
    silent.image(41)
    assert silent.waits == PATIENCE + 1


def test_an_exposure_that_is_a_little_later_than_its_image_is_in_time():
    silent = Silent()
    for stamp_ns in range(10, 40):
        silent.image(stamp_ns)
    silent.now_s += 0.02
    silent.exposures.add(39, 4.0)
    assert not silent.exposures.is_late


def test_exposures_that_are_always_too_late_are_not_waited_for():
    silent = Silent()
    for stamp_ns in range(10, 40):
        found = silent.image(stamp_ns)
        silent.now_s += 0.1
        silent.exposures.add(stamp_ns, float(stamp_ns))
    assert silent.waits == PATIENCE
    assert found is None


def test_without_a_publisher_nothing_is_missed():
    exposures = ExposureLookup()
    for stamp_ns in range(10, 40):
        exposures.at(stamp_ns, 0.0)
    assert not exposures.is_late
