# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import painted_ceiling as ceiling
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.builder import SiteBuilder
from ceiling_dso_ros.slam.localiser import Localisation, Localiser
from ceiling_dso_ros.slam.map_file import map_bytes

TRUE = ceiling.round_trip(1.6, 1.4, 24)


def drive(builder, texture, true, odom, first_stamp=0, seed=0):
    for i, (pose, believed) in enumerate(zip(true, odom)):
        builder.add(ceiling.record(texture, pose, first_stamp + i, believed, seed))


def errors_m(site, true):
    """Of the keyframes, whose stamps count the true poses; the map begins where the first drive began."""
    origin = true[0]
    return [
        np.hypot(*planar.between(planar.between(origin, true[k.record.stamp_ns]), k.pose)[:2]) for k in site.keyframes
    ]


@pytest.fixture(scope="module")
def built():
    """A round trip and a half, with an odometry that drifts by decimetres."""
    texture = ceiling.paint(10)
    odom = ceiling.drifted(TRUE, seed=5)
    builder = SiteBuilder(ceiling.RECORD_CAMERA)
    drive(builder, texture, TRUE, odom)
    return texture, builder, odom


def test_a_loop_is_closed_and_the_drift_is_gone(built):
    _, builder, odom = built
    drift_m = np.hypot(*planar.between(planar.between(TRUE[0], TRUE[-1]), odom[-1])[:2])
    site = builder.site()
    assert sum(edge.is_loop for edge in site.edges) >= 1
    assert drift_m > 0.04
    assert max(errors_m(site, TRUE)) < 0.5 * drift_m


def test_no_loop_is_wrong(built):
    _, builder, _ = built
    accepted = [decision for decision in builder.decisions if decision.accepted]
    assert len(accepted) >= 3
    for decision in accepted:
        truth = planar.between(TRUE[decision.target_ns], TRUE[decision.query_ns])
        assert np.hypot(*planar.between(truth, decision.motion)[:2]) < 0.05


def test_a_known_place_is_not_kept_twice(built):
    _, builder, _ = built
    assert len(builder.site().keyframes) <= len(TRUE) - 3


def test_the_same_drive_gives_the_same_bytes(built):
    texture, builder, odom = built
    again = SiteBuilder(ceiling.RECORD_CAMERA)
    drive(again, texture, TRUE, odom)
    assert map_bytes(again.site()) == map_bytes(builder.site())


def test_a_second_drive_is_localised_from_anywhere_and_joined(built):
    texture, builder, _ = built
    site = builder.site()
    true = ceiling.round_trip(1.6, 0.5, 24, sense=-1.0)
    odom = ceiling.drifted(true, start=(7.0, -3.0, 1.0))
    localiser = Localiser(site)
    found = []
    for i, (pose, believed) in enumerate(zip(true, odom)):
        state = localiser.add(ceiling.record(texture, pose, i, believed, seed=9))
        found.append(state)
        if state is Localisation.LOCALISED:
            error = planar.between(planar.between(TRUE[0], pose), localiser.pose)
            assert np.hypot(*error[:2]) < 0.1
            assert abs(error[2]) < np.radians(1.0)
    assert found[-1] is Localisation.LOCALISED
    assert Localisation.LOCALISED not in found[:3]


def test_another_hall_is_never_found(built):
    _, builder, _ = built
    other = ceiling.paint(77)
    localiser = Localiser(builder.site())
    for i, pose in enumerate(TRUE[:16]):
        assert localiser.add(ceiling.record(other, pose, i)) is not Localisation.LOCALISED


def test_under_a_periodic_roof_nothing_is_found_a_period_further():
    """Localised with the odometry as good as it is, a robot under such a roof closes right loops or none."""
    texture = ceiling.paint(11, period_m=1.5)
    true = ceiling.round_trip(1.6, 1.3, 24)
    builder = SiteBuilder(ceiling.RECORD_CAMERA)
    drive(builder, texture, true, ceiling.drifted(true, seed=2))
    for decision in builder.decisions:
        if decision.accepted:
            truth = planar.between(true[decision.target_ns], true[decision.query_ns])
            assert np.hypot(*planar.between(truth, decision.motion)[:2]) < 0.1
    localiser = Localiser(builder.site())
    for i, pose in enumerate(true[:14]):
        shifted = planar.compose(np.array([1.5, 0.0, 0.0]), pose)
        assert localiser.add(ceiling.record(texture, shifted, i, seed=4)) is not Localisation.LOCALISED
