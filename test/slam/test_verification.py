# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import painted_ceiling as ceiling
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.tilt import Tilt
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


LEANS = (np.radians([1.0, -0.5]), np.radians([-0.3, 0.8]))  # of two robots, by a roll and a pitch
PLACES = (np.array([0.3, -0.2, 0.5]), np.array([0.8, 0.3, 3.0]))


def verified(verifier, tilts):
    """Two views of a place by robots that lean, and the error of the motion between them."""
    texture = ceiling.paint(5)
    views = zip(PLACES, LEANS, tilts)
    found = verifier.verify(
        *(ceiling.record(texture, p, i, leans=lean, tilt=t) for i, (p, lean, t) in enumerate(views))
    )
    assert isinstance(found, Verified)
    return found, planar.between(planar.between(*PLACES), found.motion)


def test_robots_that_lean_see_one_place_where_it_is(verifier):
    """Their leaning is told. Not told, it would be a shift of the ceiling by 1 degree, 5 cm, and more."""
    found, error = verified(verifier, [Tilt(leans, np.full(2, 1e-4)) for leans in LEANS])
    assert np.hypot(*error[:2]) < 0.005
    assert error @ np.linalg.solve(found.covariance, error) < 16.0
    assert np.hypot(*verified(verifier, [ceiling.UPRIGHT] * 2)[1][:2]) > ceiling.HEIGHT_M * np.radians(1.0)


def test_the_error_of_a_tilt_is_in_the_covariance(verifier):
    """A pitch shifts the ceiling along x of its own robot, a roll along y."""
    exact, small = Tilt(LEANS[0], np.full(2, 1e-6)), np.full(2, 1e-6)
    without = verified(verifier, [exact, Tilt(LEANS[1], small)])[0].covariance
    for sigmas, along in ((np.array([1e-6, 0.01]), 0), (np.array([0.01, 1e-6]), 1)):
        added = verified(verifier, [exact, Tilt(LEANS[1], sigmas)])[0].covariance - without
        expected = np.zeros((3, 3))
        expected[along, along] = (0.01 * ceiling.HEIGHT_M) ** 2
        np.testing.assert_allclose(added, expected, atol=0.02 * expected.max())
        added = verified(verifier, [Tilt(LEANS[0], sigmas), Tilt(LEANS[1], small)])[0].covariance - without
        turned = planar.rotate_covariance(expected, PLACES[0][2] - PLACES[1][2])
        np.testing.assert_allclose(added, turned, atol=0.02 * expected.max())


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
