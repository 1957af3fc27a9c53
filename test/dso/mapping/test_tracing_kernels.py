# SPDX-License-Identifier: BSD-3-Clause
"""Tracing on a rendered surface: the interval holds the true inverse depth; the states are what they say."""

import numpy as np
import pytest
from synthetic import SHARP, Surface

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.geometry.projection import idepth_at, pixel_warp, warp_of
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.images.selection import PixelSelector, SelectedPixels
from ceiling_dso_ros.dso.mapping.tracing_kernels import best_step, epipolar_segment, trace_host
from ceiling_dso_ros.dso.window import trace_outcome
from ceiling_dso_ros.dso.window.candidates import CandidateTable

CAMERA = PinholeCamera(200.0, 205.0, 160.0, 118.0, 320, 240)
SURFACE = Surface(slope=(0.15, -0.1), relief=0.05, texture=SHARP)
REACH = 0.06 * (320 + 240)


def candidates_of(surface):
    pool = PyramidPool(CAMERA, 2)
    slot = pool.build(surface.render(np.eye(4)))
    table = CandidateTable(600)
    table.add(PixelSelector(pool).select(slot, 500), 0, pool.level(slot, 0), CAMERA.width)
    return table


def trace(table, image, T_frame_host, gain=1.0, offset=0.0, reach=REACH):
    K = CAMERA.matrix
    trace_host(
        table.arrays, 0, table.count, np.ascontiguousarray(image, np.float32).ravel(), CAMERA.width, CAMERA.height,
        K @ T_frame_host[:3, :3] @ np.linalg.inv(K), K @ T_frame_host[:3, 3], gain, offset, reach,
    )  # fmt: skip


def truth(table, surface):
    a = table.arrays
    return surface.idepth(np.eye(4), a.u[: table.count], a.v[: table.count])


def share_inside(table, idepth, which):
    a, n = table.arrays, table.count
    inside = (a.idepth_min[:n] <= idepth) & (idepth <= a.idepth_max[:n])
    return inside[which].mean()


@pytest.mark.parametrize(
    ("motion", "gain", "offset"),
    [
        ([0.06, 0.02, 0.0, 0, 0, 0], 1.0, 0.0),
        ([-0.05, 0.03, 0.02, 0.01, -0.02, 0.1], 1.0, 0.0),
        ([0.05, -0.04, 0.01, 0, 0, 0.4], 1.0, 0.0),  # yaw turns the pattern
        ([0.06, 0.0, 0.0, 0, 0, -0.2], 1.3, -12.0),
    ],
)
def test_true_inverse_depth_is_in_the_interval(motion, gain, offset):
    T = se3.exp(np.array(motion))
    table = candidates_of(SURFACE)
    image = gain * SURFACE.render(T) + offset
    trace(table, image, T, gain, offset)
    idepth, good = truth(table, SURFACE), table.arrays.outcome[: table.count] == trace_outcome.GOOD
    assert good.sum() > 0.6 * table.count
    assert share_inside(table, idepth, good) > 0.95
    middle = 0.5 * (table.arrays.idepth_min + table.arrays.idepth_max)[: table.count]
    assert np.median(np.abs(middle - idepth)[good]) < 0.02
    assert not (table.arrays.outcome[: table.count] == trace_outcome.DELETED).any()


def test_more_frames_narrow_the_interval_and_keep_the_truth():
    table = candidates_of(SURFACE)
    widths = []
    for shift in (0.04, 0.08, 0.12, 0.16):
        T = se3.exp(np.array([shift, 0.2 * shift, 0, 0, 0, 0.5 * shift]))
        trace(table, SURFACE.render(T), T)
        a, n = table.arrays, table.count
        widths.append(np.nanmedian((a.idepth_max - a.idepth_min)[:n]))
    assert widths[-1] < 0.5 * widths[0]
    bounded = np.isfinite(table.arrays.idepth_max[: table.count])
    assert share_inside(table, truth(table, SURFACE), bounded) > 0.95


def one_candidate(u, v, image):
    table = CandidateTable(1)
    one = np.ones(1, np.float32)
    table.add(SelectedPixels(u * one, v * one, one), 0, np.ascontiguousarray(image, np.float32).ravel(), CAMERA.width)
    return table


def test_out_of_the_image():
    table, T = candidates_of(SURFACE), se3.exp(np.array([3.0, 0, 0, 0, 0, 0]))
    trace(table, np.zeros((240, 320)), se3.exp(np.array([0, 0, 0, 0, 1.5, 0])) @ T)
    assert (table.arrays.outcome[: table.count] == trace_outcome.OUT_OF_BOUNDS).all()
    assert np.isnan(table.arrays.idepth_max[: table.count]).all()


def test_a_short_interval_is_left_alone():
    table, T = candidates_of(SURFACE), se3.exp(np.array([0.05, 0, 0, 0, 0, 0]))
    idepth = truth(table, SURFACE)
    a, n = table.arrays, table.count
    a.idepth_min[:n], a.idepth_max[:n] = idepth - 0.02, idepth + 0.02  # 0.4 pixels
    before = a.idepth_min[:n].copy(), a.idepth_max[:n].copy()
    trace(table, SURFACE.render(T), T)
    assert set(a.outcome[:n]) == {trace_outcome.SKIPPED, trace_outcome.OUT_OF_BOUNDS}
    assert (a.outcome[:n] == trace_outcome.SKIPPED).mean() > 0.8
    np.testing.assert_array_equal(a.idepth_min[:n], before[0])
    np.testing.assert_array_equal(a.idepth_max[:n], before[1])


def test_no_parallax_tells_nothing():
    table, T = candidates_of(SURFACE), se3.exp(np.array([0, 0, 0, 0, 0, 0.05]))
    trace(table, SURFACE.render(T), T)
    assert set(table.arrays.outcome[: table.count]) <= {trace_outcome.SKIPPED, trace_outcome.OUT_OF_BOUNDS}
    assert np.isnan(table.arrays.idepth_max[: table.count]).all()


@pytest.mark.parametrize(("along_edge", "expected"), [(True, trace_outcome.BAD_CONDITION), (False, trace_outcome.GOOD)])
def test_an_edge_along_the_epipolar_line_is_badly_conditioned(along_edge, expected):
    """A step edge along x and a shift in x; turned by a right angle the same search is fine."""
    v, u = np.mgrid[:240, :320].astype(float)
    across = v if along_edge else u
    image = 120 + 60 * np.tanh((across - 120) / 2)
    table = one_candidate(120.0 if not along_edge else 160.0, 120.0, image)
    table.arrays.idepth_min[0], table.arrays.idepth_max[0] = 0.8, 1.2
    T = se3.exp(np.array([0.05, 0, 0, 0, 0, 0]))
    shifted = image if along_edge else 120 + 60 * np.tanh((across - 130) / 2)
    trace(table, shifted, T)
    assert table.arrays.outcome[0] == expected
    if not along_edge:
        assert table.arrays.idepth_min[0] < 1.0 < table.arrays.idepth_max[0]
        assert table.arrays.idepth_max[0] - table.arrays.idepth_min[0] < 0.1


def test_what_is_not_there_is_an_outlier_and_the_second_time_deleted():
    table, T = candidates_of(SURFACE), se3.exp(np.array([0.05, 0, 0, 0, 0, 0]))
    nothing_like_it = np.full((240, 320), 1000.0)
    trace(table, nothing_like_it, T)
    states = table.arrays.outcome[: table.count].copy()
    assert (states == trace_outcome.OUTLIER).mean() > 0.7
    trace(table, nothing_like_it, T)
    assert (table.arrays.outcome[: table.count][states == trace_outcome.OUTLIER] == trace_outcome.DELETED).all()
    trace(table, SURFACE.render(T), T)  # what is deleted stays so
    assert (table.arrays.outcome[: table.count][states == trace_outcome.OUTLIER] == trace_outcome.DELETED).all()


def test_garbage_images_leave_no_garbage_intervals():
    T = se3.exp(np.array([0.05, 0.01, 0, 0, 0, 0.1]))
    for image in (np.full((240, 320), np.nan), np.full((240, 320), np.inf), np.zeros((240, 320))):
        table = candidates_of(SURFACE)
        trace(table, image, T)
        assert not (table.arrays.outcome[: table.count] == trace_outcome.GOOD).any()


def test_search_is_limited_to_its_reach():
    """A shift of 20 pixels is not found with a reach of 10."""
    T = se3.exp(np.array([0.1, 0, 0, 0, 0, 0]))
    table = candidates_of(Surface(texture=SHARP))
    trace(table, Surface(texture=SHARP).render(T), T, reach=10.0)
    good = table.arrays.outcome[: table.count] == trace_outcome.GOOD
    middle = 0.5 * (table.arrays.idepth_min + table.arrays.idepth_max)[: table.count]
    assert (middle[good] < 0.8).all()


def test_best_step_and_its_quality():
    energies = np.array([9, 8, 4, 1, 4, 8, 6, 7], np.float32)
    best, quality = best_step(energies)
    assert best == 3
    assert quality == pytest.approx(6.0)  # the neighbours within two steps do not count as rivals


@pytest.mark.parametrize("translation", [[0.1, -0.05, 0.03], [0.03, 0.1, -0.04]])  # lines along x and along y
def test_epipolar_segment_and_idepth_are_inverse(translation):
    K, T = CAMERA.matrix, se3.exp(np.array([*translation, 0.02, 0.01, 0.2]))
    Kt = K @ T[:3, 3]
    projected = K @ T[:3, :3] @ np.linalg.inv(K) @ [100.0, 80.0, 1.0]
    warp = warp_of(*pixel_warp(K, np.linalg.inv(K), T))
    x, y, ratio, line_x, line_y, length = epipolar_segment(warp, 100.0, 80.0, 0.5, 1.5, 100.0)
    assert ratio == pytest.approx(projected[2] + 0.5 * Kt[2])
    assert np.hypot(line_x, line_y) == pytest.approx(1.0)
    for idepth in (0.5, 0.9, 1.5):
        pixel = projected + Kt * idepth
        pixel = pixel[:2] / pixel[2]
        along = (pixel - [x, y]) @ [line_x, line_y]
        assert along >= -1e-9
        assert along <= length + 1e-9
        np.testing.assert_allclose([x + along * line_x, y + along * line_y], pixel, atol=1e-9)
        assert idepth_at(warp, 100.0, 80.0, *pixel, abs(line_x) > abs(line_y)) == pytest.approx(idepth)
    assert along == pytest.approx(length)
    assert epipolar_segment(warp, 100.0, 80.0, 0.5, np.nan, 7.0)[5] == 7.0
    assert epipolar_segment(warp, 100.0, 80.0, 0.5, 1.5, 2.0)[5] == 2.0
