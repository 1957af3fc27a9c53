# SPDX-License-Identifier: BSD-3-Clause
"""Strongest pixels of cells, and the share of an image that has texture."""

import numpy as np
import pytest
from synthetic import CAMERA, SHARP, Surface

from ceiling_dso_ros.dso.images.gradient_cells import TEXTURE_LEVEL, strongest_per_cell, textured_share
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import BORDER


@pytest.mark.parametrize("density", [0.03, 0.15, 0.5, 1.0])
def test_strongest_pixel_of_every_cell(density):
    width, height = 80, 60
    gradient2 = np.random.default_rng(0).uniform(0, 100, width * height).astype(np.float32)
    pixels = strongest_per_cell(gradient2, width, height, density)
    cell = max(1, round(1 / np.sqrt(density)))
    expected = set()
    for y in range(BORDER, height - BORDER - cell + 1, cell):
        for x in range(BORDER, width - BORDER - cell + 1, cell):
            _, v, u = max((gradient2[j * width + i], j, i) for j in range(y, y + cell) for i in range(x, x + cell))
            expected.add((float(u), float(v)))
    assert set(zip(pixels.u.tolist(), pixels.v.tolist())) == expected
    assert pixels.u.size == len(expected)
    if density in (0.03, 0.15, 1.0):
        assert pixels.u.size == pytest.approx(density * (width - 8) * (height - 8), rel=0.3)


def test_where_there_is_texture_noise_and_shade_are_none():
    pool = PyramidPool(CAMERA, 1)
    image = Surface(slope=(0.1, -0.1), relief=0.15, texture=SHARP).render(np.eye(4))
    dark = 2.0 + np.random.default_rng(0).normal(0.0, 2.0, image.shape) + np.linspace(0.0, 100.0, CAMERA.width)

    def share(shaded):
        pixels = np.where(np.arange(CAMERA.width) < shaded * CAMERA.width, dark, image).astype(np.float32)
        slot = pool.build(pixels)
        found = textured_share(pool.level(slot, TEXTURE_LEVEL), *pool.shape.sizes[TEXTURE_LEVEL])
        pool.release(slot)
        return found

    assert share(1.0) == 0.0
    assert share(0.5) == pytest.approx(0.5 * share(0.0), abs=0.1)
    assert share(0.0) > 0.9
