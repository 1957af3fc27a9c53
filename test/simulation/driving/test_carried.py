# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.closed_loop import ClosedLoop
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.driving.carried import LEAST_WAY_M, WALL_M, carried
from ceiling_dso_ros.simulation.driving.motion import DriveLimits, Motion, Wait, straight
from ceiling_dso_ros.simulation.events import Event, EventError
from ceiling_dso_ros.simulation.simulation import Simulation

HALL_M = (21.0, 15.0)
LIFTED_S, SET_DOWN_S = 4.0, 6.0


@pytest.fixture
def planned():
    return Motion(np.array([-3.0, 1.0, 0.4]), [straight(4.0), Wait(1.0), straight(3.0)], DriveLimits())


@pytest.fixture(params=range(5))
def motion(planned, request):
    events = [Event("slip", 1.0, 0.5), Event("kidnap", LIFTED_S, SET_DOWN_S - LIFTED_S)]
    return carried(planned, events, HALL_M, np.random.default_rng(request.param))


def test_nothing_changes_before_it(planned, motion):
    times = np.linspace(0.0, LIFTED_S, 50)
    np.testing.assert_array_equal(motion.poses(times), planned.poses(times))


def test_the_drive_goes_on_elsewhere_and_stays_in_the_hall(planned, motion):
    times = np.linspace(SET_DOWN_S, planned.duration_s, 200)
    there, here = motion.poses(times), planned.poses(times)
    np.testing.assert_allclose(np.diff(there[:, 2]), np.diff(here[:, 2]), atol=1e-12)
    steps = [np.hypot(*np.diff(poses[:, :2], axis=0).T) for poses in (there, here)]
    np.testing.assert_allclose(*steps, atol=1e-12)
    assert (np.abs(there[:, :2]) <= np.array(HALL_M) / 2 - WALL_M).all()
    along = np.array([np.cos(there[0, 2]), np.sin(there[0, 2])])
    assert (there[-1, :2] - there[0, :2]) @ along == pytest.approx(np.hypot(*(here[-1] - here[0])[:2]))
    turned = there[0, 2] - here[0, 2]
    assert turned != 0.0
    c, s, lifted = np.cos(turned), np.sin(turned), planned.poses(np.array([LIFTED_S]))[0, :2]
    moved = there[0, :2] + np.array([[c, -s], [s, c]]) @ (lifted - here[0, :2]) - lifted
    assert np.hypot(*moved) > LEAST_WAY_M


def test_it_is_carried_without_a_jump(motion):
    times = np.arange(LIFTED_S - 0.1, SET_DOWN_S + 0.1, 0.001)
    assert np.hypot(*np.diff(motion.poses(times)[:, :2], axis=0).T).max() < 0.03


def test_where_nothing_fits_it_is_set_down_opposite(planned):
    small = carried(planned, [Event("kidnap", 0.0, 1.0)], (1.0, 1.0), np.random.default_rng(0))
    np.testing.assert_allclose(small.poses(np.array([2.0]))[0, :2], -planned.poses(np.array([2.0]))[0, :2], atol=1e-12)


def test_wheels_tell_nothing_of_it():
    settings = {"sequence": "stop_and_go", "duration_s": 10.0}
    kidnapped, left_alone = (Simulation(SimulationConfig(events=events, **settings)) for events in (("kidnap",), ()))
    np.testing.assert_array_equal(kidnapped.encoders.ticks, left_alone.encoders.ticks)
    places = [drive.robot.T_world_camera(np.array([9.5]))[0, :2, 3] for drive in (kidnapped, left_alone)]
    assert np.hypot(*(places[1] - places[0])) > 0.5
    assert kidnapped.truth()["events"][0]["kind"] == "kidnap"


def test_a_robot_that_is_commanded_is_not_carried():
    with pytest.raises(EventError, match="planned"):
        ClosedLoop(SimulationConfig(events=("kidnap",), duration_s=10.0))
    drive = ClosedLoop(SimulationConfig(duration_s=10.0))
    with pytest.raises(EventError, match="planned"):
        drive.add_event("kidnap")
