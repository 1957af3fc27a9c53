# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import painted_ceiling as ceiling
import pytest

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.builder import MOST_VIEWS, RECENT_STEPS, SiteBuilder
from ceiling_dso_ros.slam.deciding import Place, Sighting
from ceiling_dso_ros.slam.localiser import Localisation, Localiser
from ceiling_dso_ros.slam.map_file import map_bytes
from ceiling_dso_ros.slam.verification import Refused, Verified, Verifier
from ceiling_dso_ros.slam.way import Way

TRUE = ceiling.round_trip(1.6, 1.4, 24)


def drive(builder, texture, true, odom, first_stamp=0, seed=0):
    return [
        decision
        for i, (pose, believed) in enumerate(zip(true, odom))
        for decision in builder.add(ceiling.record(texture, pose, first_stamp + i, believed, seed))
    ]


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
    decisions = drive(builder, texture, TRUE, odom)
    return texture, builder, odom, decisions


def test_a_loop_is_closed_and_the_drift_is_gone(built):
    _, builder, odom, _ = built
    drift_m = np.hypot(*planar.between(planar.between(TRUE[0], TRUE[-1]), odom[-1])[:2])
    site = builder.site()
    assert sum(edge.is_loop for edge in site.edges) >= 1
    assert drift_m > 0.04
    assert max(errors_m(site, TRUE)) < 0.5 * drift_m


def test_no_loop_is_wrong(built):
    decisions = built[-1]
    accepted = [decision for decision in decisions if decision.accepted]
    assert len(accepted) >= 3
    for decision in accepted:
        truth = planar.between(TRUE[decision.target_ns], TRUE[decision.query_ns])
        assert np.hypot(*planar.between(truth, decision.motion)[:2]) < 0.05


def test_a_known_place_is_not_kept_twice(built):
    builder = built[1]
    assert len(builder.site().keyframes) <= len(TRUE) - 3


def test_what_a_sighting_still_needs_is_not_let_go():
    texture, builder = ceiling.paint(10), SiteBuilder(ceiling.RECORD_CAMERA)
    poses = [np.array([0.4 * i, 0.0, 0.0]) for i in range(RECENT_STEPS + 4)]
    drive(builder, texture, poses, poses)
    newest, old = max(builder.graph.poses), 1
    builder._waiting = [Sighting(newest, old, np.zeros(3), np.eye(3), np.zeros((0, 3)))]
    builder._covered = [old, old + 1]
    builder._let_go()
    assert old in builder.graph.poses
    assert old + 1 not in builder.graph.poses
    builder._waiting = []
    builder._let_go()
    assert old not in builder.graph.poses


def test_the_way_to_a_keyframe_that_comes_late_is_a_step_back():
    texture, way = ceiling.paint(10), Way()
    records = [ceiling.record(texture, np.array([0.5 * i, 0.0, 0.0]), i) for i in (0, 1, 4, 2, 5)]
    steps = [way.add(record) for record in records]
    np.testing.assert_allclose([step.way_m for step in steps], [0.0, 0.5, 2.0, 1.0, 2.5], atol=1e-9)


def test_the_same_drive_gives_the_same_bytes(built):
    texture, builder, odom, _ = built
    again = SiteBuilder(ceiling.RECORD_CAMERA)
    drive(again, texture, TRUE, odom)
    assert map_bytes(again.site()) == map_bytes(builder.site())


def test_a_second_drive_is_localised_from_anywhere_and_joined(built):
    texture, builder, _, _ = built
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
    builder = built[1]
    other = ceiling.paint(77)
    localiser = Localiser(builder.site())
    for i, pose in enumerate(TRUE[:16]):
        assert localiser.add(ceiling.record(other, pose, i)) is not Localisation.LOCALISED


def test_under_a_periodic_roof_nothing_is_found_a_period_further():
    """Localised with the odometry as good as it is, a robot under such a roof closes right loops or none."""
    texture = ceiling.paint(11, period_m=1.5)
    true = ceiling.round_trip(1.6, 1.3, 24)
    builder = SiteBuilder(ceiling.RECORD_CAMERA)
    for decision in drive(builder, texture, true, ceiling.drifted(true, seed=2)):
        if decision.accepted:
            truth = planar.between(true[decision.target_ns], true[decision.query_ns])
            assert np.hypot(*planar.between(truth, decision.motion)[:2]) < 0.1
    localiser = Localiser(builder.site())
    for i, pose in enumerate(true[:14]):
        shifted = planar.compose(np.array([1.5, 0.0, 0.0]), pose)
        assert localiser.add(ceiling.record(texture, shifted, i, seed=4)) is not Localisation.LOCALISED


@pytest.fixture
def truthful(monkeypatch):
    """A dictionary of stamps and true poses: comparisons tell the truth about them, and refuse all other keyframes."""
    true = {}

    def verify(_self, a, b, _expected=None):
        if a.stamp_ns not in true or b.stamp_ns not in true:
            return Refused("elsewhere")
        motion = planar.between(true[a.stamp_ns], true[b.stamp_ns])
        return Verified(motion, np.diag([1e-4, 1e-4, 1e-6]), 50, 0.9, np.zeros((0, 3)))

    monkeypatch.setattr(Verifier, "verify", verify)
    return true


def test_many_laps_keep_as_many_keyframes_as_a_few(truthful):
    """Also where the light is another one on each lap, so that each shows something new."""
    texture, lap_poses = ceiling.paint(10), ceiling.round_trip(0.8, 1.0, 8)
    records = [ceiling.record(texture, pose) for pose in lap_poses]
    builder, kept = SiteBuilder(ceiling.RECORD_CAMERA), []
    for lap in range(20):
        for i, (record, pose) in enumerate(zip(records, lap_poses)):
            truthful[100 * lap + i] = pose
            image = np.clip(record.image * (0.2 + 0.05 * lap), 0, 255).astype(np.uint8)
            builder.add(replace(record, stamp_ns=100 * lap + i, image=image))
        kept.append(len(builder.site().keyframes))
    assert builder.is_placed
    assert kept[5] > kept[0]
    assert kept[-1] <= max(kept[-8:-1]) <= MOST_VIEWS * len(lap_poses) + RECENT_STEPS
    assert len(builder.site().edges) < 6 * kept[-1]


def test_a_robot_that_was_carried_away_is_noticed_and_found_again(truthful):
    texture = ceiling.paint(10)
    odom = ceiling.drifted(TRUE, seed=5)
    truthful.update(enumerate(TRUE))
    builder = SiteBuilder(ceiling.RECORD_CAMERA)
    drive(builder, texture, TRUE, odom)
    before, states = builder.site(), []
    for i in range(1, 10):  # on along the circle by the odometry, where nothing looks as it should
        believed = planar.compose(odom[-1], planar.between(TRUE[0], TRUE[i]))
        builder.add(ceiling.record(texture, TRUE[i], 100 + i, believed))
        states.append(builder.is_placed)
    assert states[0]
    assert not states[-1]
    assert builder.place is None
    assert len(builder.site().keyframes) <= len(before.keyframes)  # what it saw there is not in the map
    back = ceiling.round_trip(1.6, 0.5, 24, sense=-1.0)
    truthful.update((200 + i, pose) for i, pose in enumerate(back))
    drive(builder, texture, back, ceiling.drifted(back, start=(7.0, -3.0, 1.0)), first_stamp=200, seed=9)
    assert builder.is_placed
    error = planar.between(planar.between(TRUE[0], back[-1]), builder.place.pose)
    assert np.hypot(*error[:2]) < 0.1


def test_a_map_goes_on_from_its_file(built, truthful):
    texture, builder, _, _ = built
    again = SiteBuilder(ceiling.RECORD_CAMERA, builder.site())
    assert map_bytes(again.site()) == map_bytes(builder.site())
    assert not again.is_placed
    true = ceiling.round_trip(1.6, 0.5, 24, sense=-1.0)
    truthful.update([*enumerate(TRUE), *((300 + i, pose) for i, pose in enumerate(true))])
    drive(again, texture, true, ceiling.drifted(true, start=(7.0, -3.0, 1.0)), first_stamp=300, seed=9)
    assert again.is_placed
    assert again.site().sessions == builder.site().sessions + 1


def test_a_place_that_was_named_needs_fewer_keyframes_and_a_wrong_one_is_not_believed(built, truthful):
    texture, builder, _, _ = built
    true = ceiling.round_trip(1.6, 0.5, 24, sense=-1.0)
    truthful.update([*enumerate(TRUE), *((300 + i, pose) for i, pose in enumerate(true))])
    odom = ceiling.drifted(true)
    rough = np.diag([0.25, 0.25, 0.07])

    def keyframes_until_found(offset):
        localiser = Localiser(builder.site())
        localiser.believe(Place(planar.compose(planar.between(TRUE[0], true[0]), np.asarray(offset)), rough))
        for i, (pose, believed) in enumerate(zip(true, odom)):
            if localiser.add(ceiling.record(texture, pose, 300 + i, believed, seed=9)) is Localisation.LOCALISED:
                error = planar.between(planar.between(TRUE[0], pose), localiser.pose)
                assert np.hypot(*error[:2]) < 0.1
                return i + 1
        return np.inf

    assert keyframes_until_found([0.3, -0.2, 0.1]) <= 3
    assert keyframes_until_found([3.0, 0.0, 3.0]) > 3
