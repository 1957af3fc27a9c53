# SPDX-License-Identifier: BSD-3-Clause
"""The ceilings that can be simulated, by name."""

from typing import Callable, Dict

import numpy as np

from ceiling_dso_ros.simulation.ceilings.drawn import random_hall
from ceiling_dso_ros.simulation.ceilings.factory import factory
from ceiling_dso_ros.simulation.ceilings.plaster import plaster
from ceiling_dso_ros.simulation.ceilings.tiles import tiles
from ceiling_dso_ros.simulation.ceilings.warehouse import warehouse
from ceiling_dso_ros.simulation.rendering.scene import Hall

CEILINGS: Dict[str, Callable[[np.random.Generator], Hall]] = {
    "factory": factory,
    "tiles": tiles,
    "warehouse": warehouse,
    "plaster": plaster,
    "random": random_hall,
}
