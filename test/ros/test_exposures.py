# SPDX-License-Identifier: BSD-3-Clause
import threading

from ceiling_dso_ros.ros.exposures import ExposureLookup


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
