# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.simulation.rendering import materials
from ceiling_dso_ros.simulation.rendering.materials import Material

MATERIALS = {name: value for name, value in vars(materials).items() if isinstance(value, Material)}


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("size_m", [(0.01, 0.02), (21.0, 0.03), (0.3, 4.0), (1.7, 1.1)])
def test_every_material_can_be_painted_on_anything(name, size_m):
    material = MATERIALS[name]
    values = material.canvas(size_m, 0.006, (3, 1)).values
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
    assert material.luminous or values.max() < 1.2
    assert values.mean() == pytest.approx(material.base, rel=0.75)


@pytest.mark.parametrize("name", ["DECK", "MINERAL_TILES", "PLASTER", "CONCRETE"])
def test_ceilings_have_little_contrast(name):
    values = MATERIALS[name].canvas((3.0, 3.0), 0.006, (3, 1)).values
    low, high = np.percentile(values, [10, 90])
    assert high / low < 1.4


def test_letters_stand_out():
    values = materials.lettering("ZONE A1").canvas((1.2, 0.3), 0.005, (3, 1)).values
    assert values.max() > 5 * values.min()
