# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from synthetic import CAMERA

from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.vignette import Vignette

DARK_CORNERS = Vignette(CAMERA, (-0.3, -0.1))


def image():
    return np.random.default_rng(0).uniform(20.0, 200.0, (CAMERA.height, CAMERA.width)).astype(np.float32)


def levels(pool, slot):
    return [pool.level(slot, level).copy() for level in range(pool.shape.levels)]


def test_it_is_one_at_the_principal_point_and_falls_towards_the_farthest_corner():
    share = 1.0 / DARK_CORNERS.inverse
    assert share[round(CAMERA.cy), round(CAMERA.cx)] == pytest.approx(1.0, abs=1e-5)
    corner = share[-1, 0]  # of this camera, the one that is farthest from its principal point
    assert corner == share.min() == pytest.approx(np.exp(-0.4), rel=1e-5)
    assert Vignette(CAMERA).inverse is None


def test_an_image_is_divided_on_all_levels():
    pool, bright = PyramidPool(CAMERA, 2), image()
    plain, corrected = pool.build(bright), pool.build(bright / DARK_CORNERS.inverse, vignette=DARK_CORNERS)
    assert pool.vignette(corrected) is DARK_CORNERS
    for a, b in zip(levels(pool, plain), levels(pool, corrected)):
        assert np.allclose(a, b, rtol=1e-5)


@pytest.mark.parametrize("before", [(0.0, 0.0), (0.2, -0.3)])
def test_an_image_can_be_corrected_anew(before):
    pool, seen = PyramidPool(CAMERA, 2), image()
    changed, expected = pool.build(seen, vignette=Vignette(CAMERA, before)), pool.build(seen, vignette=DARK_CORNERS)
    pool.correct(changed, DARK_CORNERS)
    assert pool.vignette(changed) is DARK_CORNERS
    for a, b in zip(levels(pool, changed), levels(pool, expected)):
        assert np.allclose(a, b, rtol=1e-5)


def test_a_slot_that_is_used_again_is_not_corrected_any_more():
    pool, seen = PyramidPool(CAMERA, 1), image()
    pool.release(pool.build(seen, vignette=DARK_CORNERS))
    assert np.array_equal(pool.level(pool.build(seen), 0).reshape(seen.shape), seen)


def test_nothing_is_computed_again_where_nothing_changes(monkeypatch):
    """As for each image of a lens without vignetting."""
    pool = PyramidPool(CAMERA, 1)
    for vignette in (Vignette(CAMERA), DARK_CORNERS):
        slot = pool.build(image(), vignette=vignette)
        with monkeypatch.context() as patch:
            patch.setattr(pool, "_halve", lambda _slot: pytest.fail("halved again"))
            pool.correct(slot, Vignette(CAMERA, vignette.coefficients))
        pool.release(slot)
