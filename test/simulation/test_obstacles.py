# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.obstacles import Obstacles, draw_traffic, person, vehicle
from ceiling_dso_ros.simulation.rendering.structures import room_plan


def test_the_clearance_is_that_to_the_nearest_wall_or_mover():
    obstacles = Obstacles(room_plan(20.0, 10.0, [[4.0, 0.0, 1.0, 1.0]]), (vehicle((-5.0, 0.0), (-5.0, 4.0), 1.0),))
    points = np.array([[0.0, 4.0], [1.0, 0.5], [-4.0, 0.0], [-4.0, 3.0], [-5.0, 3.0]])
    times = np.array([0.0, 0.0, 0.0, 3.0, 3.0])  # by then the vehicle has moved on, and stands over the last point
    np.testing.assert_allclose(obstacles.clearance_m(points, times), [1.0, 2.0, 0.6, 0.6, 0.0], atol=1e-9)


def test_the_map_has_the_outlines_of_what_stands():
    obstacles = Obstacles(room_plan(20.0, 10.0, [[4.0, 0.0, 1.0, 1.0]]), (vehicle((-5.0, 0.0), (-5.0, 4.0)),))
    hall = obstacles.floor_map()

    def is_occupied(x, y):
        column, row = ((np.array([x, y]) - hall.corner) / hall.cell_m).astype(int)
        return hall.occupied[row - 1 : row + 2, column - 1 : column + 2].any()

    assert all(is_occupied(x, y) for x, y in ((10.0, 3.3), (-10.0, -4.0), (0.02, 5.0), (3.0, 0.4), (4.7, -1.0)))
    assert not any(is_occupied(x, y) for x, y in ((0.0, 0.0), (4.0, 0.0), (-5.0, 0.4), (9.5, 4.5)))


def test_people_walk_back_and_forth_on_two_legs():
    walker = person((1.0, 2.0), (4.0, 2.0), speed_m_s=1.5)
    times = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    legs = walker.centers(times)
    assert legs.shape == (5, 2, 2)
    np.testing.assert_allclose(
        legs.mean(axis=1), [[1.0, 2.0], [2.5, 2.0], [4.0, 2.0], [2.5, 2.0], [1.0, 2.0]], atol=1e-9
    )
    apart = np.abs(np.diff(walker.centers(np.linspace(0.0, 4.0, 200)), axis=1))[:, 0]
    assert apart[:, 0].max() == pytest.approx(0.6, abs=0.01), "a step"
    np.testing.assert_allclose(apart[:, 1], 0.22)


def test_traffic_is_drawn_by_the_seed_stays_in_the_hall_and_keeps_away_from_the_robot():
    times = np.arange(0.0, 60.0, 0.1)
    robot = np.column_stack([5.0 * np.sin(0.1 * times), 3.0 * np.cos(0.1 * times)])
    drawn = [draw_traffic(np.random.default_rng(seed), (21.0, 15.0), 12, times, robot) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert len(drawn[0]) == 12
    assert len({mover.radius_m for mover in drawn[0]}) == 2, "people and vehicles"
    for mover in drawn[0]:
        places = mover.centers(times)
        assert (np.abs(places) < (10.5, 7.5)).all()
        assert np.ptp(places.reshape(-1, 2), axis=0).max() > 2.0
        assert (np.linalg.norm(places - robot[:, None], axis=-1) - mover.radius_m).min() > 0.7


def test_where_the_robot_leaves_no_room_there_is_less_traffic():
    everywhere = np.random.default_rng(0).uniform((-3.0, -2.0), (3.0, 2.0), (4000, 2))
    assert draw_traffic(np.random.default_rng(0), (6.0, 4.0), 3, np.arange(4000) * 0.1, everywhere) == ()
