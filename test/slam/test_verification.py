# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import painted_ceiling as ceiling
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.verification import Refused, Verified, Verifier


@pytest.fixture(scope="module")
def verifier():
    return Verifier(ceiling.RECORD_CAMERA)


@pytest.mark.parametrize("turn", [0.1, 1.7, 3.1, -2.2])
def test_two_views_of_a_place_give_their_motion_at_any_yaw(verifier, turn):
    texture = ceiling.paint(0)
    a, b = np.array([0.3, -0.2, 0.5]), np.array([0.8, 0.3, 0.5 + turn])
    found = verifier.verify(ceiling.record(texture, a, 1), ceiling.record(texture, b, 2))
    assert isinstance(found, Verified)
    error = planar.between(planar.between(a, b), found.motion)
    assert np.hypot(*error[:2]) < 0.01
    assert abs(error[2]) < 0.003
    assert error @ np.linalg.solve(found.covariance, error) < 16.0
    assert len(found.others) == 0


def test_other_light_changes_nothing(verifier):
    texture = ceiling.paint(1)
    a, b = np.array([0.0, 0.0, 0.0]), np.array([0.3, -0.3, 2.0])
    found = verifier.verify(ceiling.record(texture, a, 1), ceiling.record(texture, b, 2, gain=0.6))
    assert isinstance(found, Verified)
    assert np.hypot(*planar.between(planar.between(a, b), found.motion)[:2]) < 0.015


def test_other_places_are_refused(verifier):
    texture = ceiling.paint(2)
    places = [np.array([x, y, 0.4 * x]) for x in (-5.0, 0.0, 5.0) for y in (-3.0, 3.0)]
    records = [ceiling.record(texture, place, i) for i, place in enumerate(places)]
    for i, a in enumerate(records):
        for b in records[:i]:
            assert isinstance(verifier.verify(a, b), Refused)


def test_under_a_periodic_roof_other_shifts_are_seen_or_nothing(verifier):
    """The period is smaller than the view, so a view explains itself a period further."""
    texture = ceiling.paint(3, period_m=1.2)
    a = np.array([0.0, 0.0, 0.0])
    for b in (np.array([0.2, 0.1, 0.3]), np.array([1.3, 0.0, 0.0])):
        found = verifier.verify(ceiling.record(texture, a, 1), ceiling.record(texture, b, 2))
        if isinstance(found, Verified):
            assert len(found.others) > 0
