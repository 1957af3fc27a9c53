# SPDX-License-Identifier: BSD-3-Clause
"""What a new candidate stores, and that rows stay together."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from ceiling_dso_ros.dso.images.pattern import PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.images.selection import SelectedPixels
from ceiling_dso_ros.dso.window.candidates import CandidateTable
from ceiling_dso_ros.dso.window.trace_outcome import UNTRACED

WIDTH, HEIGHT = 60, 40
IMAGE = np.random.default_rng(0).uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32)


def pixels(n, seed=0):
    rng = np.random.default_rng(seed)
    return SelectedPixels(
        rng.integers(5, WIDTH - 6, n).astype(np.float32),
        rng.integers(5, HEIGHT - 6, n).astype(np.float32),
        rng.choice([1.0, 2.0, 4.0], n).astype(np.float32),
    )


def three_hosts():
    table = CandidateTable(40)
    for host in range(3):
        table.add(pixels(8 + host, seed=host), host, IMAGE.ravel(), WIDTH)
    return table


def rows(table):
    a, n = table.arrays, table.count
    return {
        (float(a.u[i]), float(a.v[i]), float(a.kind[i]), a.grey[:, i].tobytes(), a.weight[:, i].tobytes())
        for i in range(n)
    }


def test_pattern_is_that_of_the_method():
    assert sorted(zip(PATTERN_X.tolist(), PATTERN_Y.tolist())) == sorted(
        [(0, -2), (-1, -1), (1, -1), (-2, 0), (0, 0), (2, 0), (-1, 1), (0, 2)]
    )


def test_a_new_candidate_holds_its_pattern():
    chosen, table = pixels(10), CandidateTable(20)
    table.add(chosen, 3, IMAGE.ravel(), WIDTH)
    a = table.arrays
    grad_y, grad_x = np.gradient(IMAGE.astype(float))
    x, y = chosen.u + PATTERN_X[:, None], chosen.v + PATTERN_Y[:, None]
    grey, gx, gy = (map_coordinates(image, [y, x], order=1) for image in (IMAGE.astype(float), grad_x, grad_y))
    np.testing.assert_allclose(a.grey[:, :10], grey, rtol=1e-5)
    np.testing.assert_allclose(a.weight[:, :10], np.sqrt(50**2 / (50**2 + gx**2 + gy**2)), rtol=1e-5)
    np.testing.assert_allclose(a.grad_xx[:10], (gx * gx).sum(0), rtol=1e-4)
    np.testing.assert_allclose(a.grad_xy[:10], (gx * gy).sum(0), rtol=1e-4, atol=1)
    np.testing.assert_allclose(a.grad_yy[:10], (gy * gy).sum(0), rtol=1e-4)
    np.testing.assert_array_equal(a.kind[:10], chosen.kind)
    assert (a.host[:10] == 3).all()
    assert (a.outcome[:10] == UNTRACED).all()
    assert (a.idepth_min[:10] == 0).all()
    assert np.isnan(a.idepth_max[:10]).all()


def test_ranges_of_hosts():
    table = three_hosts()
    assert table.host_ranges(4).tolist() == [0, 8, 17, 27, 27]


def test_what_does_not_fit_is_left_out():
    table = CandidateTable(12)
    table.add(pixels(8), 0, IMAGE.ravel(), WIDTH)
    table.add(pixels(8), 1, IMAGE.ravel(), WIDTH)
    assert table.count == table.capacity == 12
    assert table.host_ranges(2).tolist() == [0, 8, 12]


def test_keep_keeps_whole_rows_in_order():
    table = three_hosts()
    mask = np.random.default_rng(1).uniform(size=table.count) < 0.5
    expected = [array[..., : table.count][..., mask].copy() for array in table.arrays]
    table.keep(mask)
    assert table.count == mask.sum()
    for array, values in zip(table.arrays, expected):
        np.testing.assert_array_equal(array[..., : table.count], values)


def test_removing_a_host_moves_later_ones_down():
    table = three_hosts()
    before = rows(table)
    host1 = CandidateTable(40)
    host1.add(pixels(9, seed=1), 1, IMAGE.ravel(), WIDTH)
    table.remove_host(1)
    assert table.host_ranges(2).tolist() == [0, 8, 18]
    assert rows(table) == before - rows(host1)


@pytest.mark.parametrize("hosts", [1, 5])
def test_an_empty_table_has_empty_ranges(hosts):
    assert CandidateTable(5).host_ranges(hosts).tolist() == [0] * (hosts + 1)
