# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.ceilings.other_lights import UNLIT, with_lamps_off
from ceiling_dso_ros.simulation.config import ConfigError, SimulationConfig
from ceiling_dso_ros.simulation.simulation import Simulation


@pytest.mark.parametrize("ceiling", ["factory", "random"])
def test_a_third_of_the_lamps_is_off_and_dark_and_all_else_stays(ceiling):
    hall = CEILINGS[ceiling](np.random.default_rng(3))
    other = with_lamps_off(hall, np.random.default_rng(0))
    assert len(other.lamps) == len(hall.lamps) - round(len(hall.lamps) / 3)
    assert len(other.surfaces) == len(hall.surfaces)
    changed = [after for before, after in zip(hall.surfaces, other.surfaces) if before is not after]
    assert len(changed) >= len(hall.lamps) - len(other.lamps)
    assert all(surface.sheet.material is UNLIT for surface in changed)


def test_a_session_starts_elsewhere_in_the_same_hall():
    first, second = (Simulation(SimulationConfig("weave", "random", 4, session=session)) for session in (0, 1))
    starts = [simulation.robot.T_world_base(np.zeros(1))[0, :2, 3] for simulation in (first, second)]
    assert np.hypot(*(starts[0] - starts[1])) > 0.5
    assert first.hall.size_m == second.hall.size_m
    assert first.hall.description == second.hall.description
    np.testing.assert_array_equal(first.robot.true.wheel_radius_m, second.robot.true.wheel_radius_m)


def test_tours_need_a_free_floor():
    with pytest.raises(ConfigError, match="all over the floor"):
        SimulationConfig("aisles", "factory").check()
