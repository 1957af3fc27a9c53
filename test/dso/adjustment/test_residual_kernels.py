# SPDX-License-Identifier: BSD-3-Clause
"""The Jacobians of all points against numeric differences, and the sums over the pattern against numpy."""

import numpy as np
import pytest
from samples import sample
from synthetic import CAMERA, POSES, SLANTED

from ceiling_dso_ros.dso.adjustment.residual_kernels import (
    LivePoints,
    add_combination,
    add_dots,
    combine,
    dot4,
    fill_jacobian,
    gather_live,
    pixel_sums,
    sum_pattern,
)
from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.images.pattern import PATTERN_X, PATTERN_Y

T_TARGET_HOST = se3.exp(np.array([0.15, -0.1, 0.08, 0.05, -0.08, 0.3]))
INTRINSICS = np.array([200.0, 215.0, 160.0, 118.0])


def project(u, v, idepth, intrinsics, T):
    fx, fy, cx, cy = intrinsics
    x, y, z = T[:3, :3] @ [(u - cx) / fx, (v - cy) / fy, 1.0] + T[:3, 3] * idepth
    return np.array([fx * x / z + cx, fy * y / z + cy])


def numeric_jacobian(u, v, idepth, intrinsics, T):
    columns, h = [], 1e-6
    for e in np.eye(4):
        plus, minus = (project(u, v, idepth, intrinsics + s * h * e, T) for s in (1, -1))
        columns.append((plus - minus) / (2 * h))
    for e in np.eye(6):
        plus, minus = (project(u, v, idepth, intrinsics, se3.exp(s * h * e) @ T) for s in (1, -1))
        columns.append((plus - minus) / (2 * h))
    plus, minus = (project(u, v, idepth + s * h, intrinsics, T) for s in (1, -1))
    return np.stack([*columns, (plus - minus) / (2 * h)], axis=1)


def test_filled_rows_are_the_jacobians_of_all_points():
    rng = np.random.default_rng(0)
    u, v, idepth = (rng.uniform(a, b, 20).astype(np.float32) for a, b in ((20, 300), (20, 220), (0.3, 2)))
    rows_x, rows_y = np.zeros((11, 20), np.float32), np.zeros((11, 20), np.float32)
    R, t = T_TARGET_HOST[:3, :3].astype(np.float32), T_TARGET_HOST[:3, 3].astype(np.float32)
    fill_jacobian(u, v, idepth, INTRINSICS.astype(np.float32), R, t, tuple(rows_x), tuple(rows_y))
    for i in range(20):
        expected = numeric_jacobian(float(u[i]), float(v[i]), float(idepth[i]), INTRINSICS, T_TARGET_HOST)
        np.testing.assert_allclose(np.stack([rows_x[:, i], rows_y[:, i]]), expected, rtol=1e-3, atol=2e-3)


def expected_sums(image, u, v, idepth, grey, weight_host, gain, offset, host_offset, T):
    """The sums of one point, pixel by pixel in float64, by their definition."""
    pixels = [project(u + du, v + dv, idepth, CAMERA.parameters, T) for du, dv in zip(PATTERN_X, PATTERN_Y)]
    value, gx, gy = sample(image, *np.array(pixels).T)
    r, d = value - gain * grey - offset, grey - host_offset
    weight2 = (0.5 * (weight_host + np.sqrt(2500 / (2500 + gx**2 + gy**2)))) ** 2
    size = np.abs(r)
    w = weight2 * np.where(size > 9, 9 / np.maximum(size, 9), 1)
    energy = weight2 * np.where(size > 9, 2 * 9 * size - 81, r * r)
    named = {
        "gxx": w * gx * gx, "gxy": w * gx * gy, "gyy": w * gy * gy, "dx": w * d * gx, "dy": w * d * gy,
        "ox": w * gx, "oy": w * gy, "rx": w * r * gx, "ry": w * r * gy, "dd": w * d * d, "do": w * d, "oo": w,
        "dr": w * d * r, "or_": w * r, "energy": energy, "gradient": weight2 * (gx**2 + gy**2),
    }  # fmt: skip
    return {name: values.sum() for name, values in named.items()}


@pytest.mark.parametrize("error", [0.0, 6.0, 40.0])  # grey levels added: small, and on both sides of Huber's threshold
def test_sums_over_the_pattern(error):
    image = SLANTED.render(POSES[1])
    rng = np.random.default_rng(0)
    n = 15
    u, v = rng.uniform(60, 260, n).astype(np.float32), rng.uniform(60, 180, n).astype(np.float32)
    idepth = SLANTED.idepth(POSES[0], u, v).astype(np.float32)
    grey = (rng.uniform(90, 150, (8, n)) + error).astype(np.float32)
    weight = rng.uniform(0.5, 1, (8, n)).astype(np.float32)
    K, T = CAMERA.matrix, POSES[1]
    KRKi, Kt = (K @ T[:3, :3] @ np.linalg.inv(K)).astype(np.float32), (K @ T[:3, 3]).astype(np.float32)
    gain, offset, host_offset = np.float32(1.1), np.float32(-5), np.float32(3)
    sums = pixel_sums(n)
    points = LivePoints(np.arange(n), u, v, idepth, grey, weight)
    sum_pattern(image.ravel(), 320, 240, KRKi, Kt, gain, offset, host_offset, points, n, sums)
    for i in range(n):
        expected = expected_sums(
            image, u[i], v[i], idepth[i], grey[:, i], weight[:, i], gain, offset, host_offset, T
        )  # fmt: skip
        bound = {"r": np.sqrt(expected["energy"] * expected["gradient"])}
        for name, value in expected.items():
            assert getattr(sums, name)[i] == pytest.approx(value, rel=2e-3, abs=1e-3 * bound["r"] + 0.05), name
        assert sums.in_bounds[i] == 1


@pytest.mark.parametrize(
    ("u", "v", "idepth", "inside"),
    [(160, 120, 1.0, 1), (5, 120, 1.0, 1), (4, 120, 1.0, 0), (160, 4, 1.0, 0), (315, 120, 1.0, 0), (160, 235, 1.0, 0)],
)
def test_a_pattern_that_leaves_the_image_is_out_of_bounds(u, v, idepth, inside):
    """With no motion the outermost pixel of the pattern, two off the centre, must lie more than two inside."""
    args = [np.full(1, value, np.float32) for value in (u, v, idepth)]
    image, sums = np.zeros(320 * 240, np.float32), pixel_sums(1)
    one, zero = np.float32(1), np.float32(0)
    eight = np.ones((8, 1), np.float32)
    points = LivePoints(np.zeros(1, int), *args, eight, eight)
    sum_pattern(
        image, 320, 240, np.eye(3, dtype=np.float32), np.zeros(3, np.float32), one, zero, zero, points, 1, sums
    )  # fmt: skip
    assert sums.in_bounds[0] == inside


def test_a_point_behind_the_camera_is_out_of_bounds():
    args = [np.full(1, value, np.float32) for value in (160, 120, 1.0)]
    image, sums = np.zeros(320 * 240, np.float32), pixel_sums(1)
    one, zero = np.float32(1), np.float32(0)
    eight = np.ones((8, 1), np.float32)
    # twice the depth back: z = -1, and the pixel itself is back in the image
    Kt = -2 * np.array([160, 120, 1], np.float32)
    points = LivePoints(np.zeros(1, int), *args, eight, eight)
    sum_pattern(image, 320, 240, np.eye(3, dtype=np.float32), Kt, one, zero, zero, points, 1, sums)
    assert sums.in_bounds[0] == 0
    assert np.isfinite(sums.energy[0])


def test_live_points_are_gathered_in_order():
    rng = np.random.default_rng(0)
    u, v, idepth = rng.normal(size=(3, 9)).astype(np.float32)
    grey, weight = rng.normal(size=(2, 8, 9)).astype(np.float32)
    points = LivePoints.of_capacity(6)
    count = gather_live(np.array([0, 1, 1, 0, 1, 0], np.uint8), u, v, idepth, grey, weight, 2, points)
    assert points.index[:count].tolist() == [1, 2, 4]
    which = [3, 4, 6]
    for ours, source in ((points.u, u), (points.v, v), (points.idepth, idepth)):
        np.testing.assert_array_equal(ours[:count], source[which])
    np.testing.assert_array_equal(points.grey[:, :count], grey[:, which])
    np.testing.assert_array_equal(points.weight[:, :count], weight[:, which])


def test_vector_helpers():
    rng = np.random.default_rng(0)
    a, x, b, y, c = (rng.normal(size=37).astype(np.float32) for _ in range(5))
    out = np.full(37, np.nan, np.float32)
    combine(a, x, b, y, out)
    np.testing.assert_allclose(out, a * x + b * y, atol=1e-6)
    add_combination(b, c, c, c, out)
    np.testing.assert_allclose(out, a * x + b * y + b * c + c * c, atol=1e-5)
    np.testing.assert_allclose(dot4(x, a, b, y, c), [x @ a, x @ b, x @ y, x @ c], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("others", [6, 7, 8, 9])
def test_dots_fill_the_upper_triangle(others):
    rng = np.random.default_rng(0)
    rows, columns = rng.normal(size=(5, 40)).astype(np.float32), rng.normal(size=(others, 40)).astype(np.float32)
    total = np.ones((others, others))
    add_dots(rows, columns, 30, 5, total)
    expected = np.ones((others, others))
    upper = np.triu_indices(others)
    full = rows[:, :30].astype(float) @ columns[:, :30].astype(float).T
    for i, j in zip(*upper):
        if i < 5:
            expected[i, j] += full[i, j]
    np.testing.assert_allclose(total, expected, atol=1e-5)
