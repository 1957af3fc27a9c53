# SPDX-License-Identifier: BSD-3-Clause
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from ceiling_dso_ros.simulation.rendering.canvas import Canvas, _cubic_weights


def canvas(size_m=(2.0, 1.0), texel_m=0.005, base=0.5):
    return Canvas(size_m, texel_m, (1, 2, 3), base)


def test_texels_are_samples_that_cover_the_rectangle():
    values = canvas((0.1, 0.023), 0.01).values
    assert values.shape == (3 + 2, 10 + 2)
    assert (values == 0.5).all()


@pytest.mark.parametrize("width_m", [0.004, 0.013, 0.2])
def test_a_stripe_darkens_its_width_whatever_the_texels(width_m):
    for texel_m in (0.003, 0.01, 0.017):
        sheet = canvas(texel_m=texel_m)
        sheet.stripes(0, np.array([0.777]), width_m, 0.0)
        lost_m = (1.0 - sheet.values[0] / 0.5).sum() * texel_m
        assert lost_m == pytest.approx(width_m, rel=1e-3)


def test_a_rectangle_covers_its_area_and_only_that():
    sheet = canvas(texel_m=0.007)
    sheet.rectangle((0.3, 0.2), (0.51, 0.33), 0.0)
    assert (1.0 - sheet.values / 0.5).sum() * 0.007**2 == pytest.approx(0.51 * 0.33, rel=1e-3)
    sheet.rectangle((5.0, 5.0), (1.0, 1.0), 0.0)
    assert sheet.values[0, 0] == 0.5


def test_noise_has_the_amplitude_and_is_the_same_at_every_resolution():
    fine, coarse = canvas((4.0, 3.0), 0.004), canvas((4.0, 3.0), 0.02)
    for sheet in (fine, coarse):
        sheet.noise((0.01, 0.01), 0.1)  # the coarse one cannot show it, the next layer must not depend on that
        sheet.noise((0.3, 0.2), 0.1)
    reference = canvas((4.0, 3.0), 0.004)
    reference.noise((0.3, 0.2), 0.1)
    assert np.std(reference.values / 0.5) == pytest.approx(0.1, rel=0.15)
    fine.low_pass(0.02)
    coarse.low_pass(0.02)
    difference = fine.values[::5, ::5][:150, :200] - coarse.values[:150, :200]
    assert np.std(difference) < 0.15 * np.std(coarse.values)


def test_noise_is_the_same_to_the_bit_however_threads_share_the_work():
    def paint(_):
        sheet = canvas((3.5, 1.3), 0.004)
        for wave in ((0.071, 0.047), (0.111, 0.042), (0.093, 0.033)):
            sheet.noise(wave, 0.1)
        return sheet.values

    with ThreadPoolExecutor(2) as executor:
        first, *others = executor.map(paint, range(20))
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_noise_passes_through_its_nodes_and_goes_on_at_the_edges():
    weights = _cubic_weights(5, 4.0, 30).toarray()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(weights[9], weights[10, ::-1], atol=1e-6)  # about node 2, which is at texel 9.5
    np.testing.assert_allclose(_cubic_weights(5, 5.0, 25).toarray()[2::5], np.eye(5), atol=1e-6)
    np.testing.assert_allclose(weights[-1], [0.0, 0.0, 0.0, 0.0, 1.0], atol=1e-6)


def test_spots_and_curves_stay_on_the_canvas():
    sheet = canvas()
    sheet.spots(np.array([[0.0, 0.0], [2.0, 1.0], [-3.0, 0.5], [0.5, 0.5]]), 0.02, 0.0)
    sheet.curve(np.array([[-1.0, -1.0], [3.0, 2.0]]), 0.01, 0.5)
    sheet.curve(np.array([[5.0, 5.0], [6.0, 6.0]]), 0.01, 0.5)
    assert sheet.values[100, 100] == pytest.approx(0.0, abs=1e-3)
    assert sheet.values.min() >= 0.0
    assert sheet.values.max() <= 0.5
    assert sheet.values[60, 60] == 0.5


def test_text_is_upright_for_who_looks_at_the_side_with_u_right_and_v_up():
    sheet = canvas((0.4, 0.4), 0.004, 0.1)
    sheet.text("L", 8.0)
    bright = sheet.values > 0.4
    middle = bright.shape[0] // 2
    assert bright[:middle].sum() > 1.3 * bright[middle:].sum()  # the bar of the L is at small v
    assert bright[:, :middle].sum() > 1.3 * bright[:, middle:].sum()  # its stem at small u


def test_the_low_pass_removes_what_the_camera_cannot_resolve():
    sheet = canvas((1.0, 1.0), 0.005)
    sheet.stripes(0, np.arange(0.0, 1.0, 0.02), 0.01, 0.0)
    sheet.low_pass(0.02)
    inner = sheet.values[50:-50, 50:-50]
    assert np.ptp(inner) < 0.01 * inner.mean()
