# SPDX-License-Identifier: BSD-3-Clause
"""A whole hall drawn at random."""

import numpy as np

from ceiling_dso_ros.simulation.ceilings.drawn.coverings import draw_covering
from ceiling_dso_ros.simulation.ceilings.drawn.hangings import draw_hangings
from ceiling_dso_ros.simulation.ceilings.drawn.lights import draw_lights
from ceiling_dso_ros.simulation.ceilings.drawn.roofs import draw_roof
from ceiling_dso_ros.simulation.obstacles import Obstacles, person, vehicle
from ceiling_dso_ros.simulation.rendering import materials, structures
from ceiling_dso_ros.simulation.rendering.scene import Hall

SHORTEST_M, NARROWEST_M = 21.0, 15.0  # in which all sequences can be driven
LOWEST_M, HIGHEST_M = 2.5, 12.0
SHARE_PERIODIC = 0.12


def random_hall(rng: np.random.Generator) -> Hall:
    """Any hall: offices, factories, warehouses, vaults; some of them strictly periodic."""
    height = float(np.exp(rng.uniform(np.log(LOWEST_M), np.log(HIGHEST_M))))
    stretch = rng.uniform(1.0, 1.0 + 0.05 * height, 2)
    size = float(SHORTEST_M * stretch[0]), float(NARROWEST_M * stretch[1])
    is_periodic = bool(rng.random() < SHARE_PERIODIC)
    roof = draw_roof(rng, size, height)
    covering = draw_covering(rng, is_periodic, 2.0 * height)
    hangings = draw_hangings(rng, roof, is_periodic)
    lights = draw_lights(rng, roof, is_periodic)
    wall = [materials.CLADDING, materials.PAINTED_WALL, materials.CONCRETE][rng.integers(3)]
    surfaces = [*roof.surfaces(covering.material), *structures.room_walls(*size, roof.highest_m, wall)]
    for made in hangings.values():
        surfaces += made
    movers = (person((-8.0, 5.8), (8.0, 5.8)), vehicle((8.4, -5.0), (8.4, 4.5)))
    description = {
        "roof": roof.kind,
        "height_m": [roof.lowest_m, roof.highest_m],
        "is_periodic": is_periodic,
        "covering": covering.kind,
        "contrast": covering.contrast,
        "dirt": covering.dirt,
        "hangings": {name: len(made) for name, made in hangings.items()},
        "lamps": lights.kind,
        "lamp_count": lights.lamps,
        "lamps_off": lights.share_off,
        "skylights": lights.skylights,
        "sun_patches": lights.sun_patches,
    }
    obstacles = Obstacles(structures.room_plan(*size), movers)
    return Hall(surfaces + lights.surfaces, lights.sources, size, obstacles, description)
