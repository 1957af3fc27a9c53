# SPDX-License-Identifier: BSD-3-Clause
"""The projection against its definition in numpy, and its derivatives against numeric differences; all in float64."""

import numba
import numpy as np
import pytest

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import (
    Intrinsics,
    Warp,
    epipolar_direction,
    idepth_at,
    in_view,
    intrinsic_inverse,
    intrinsic_matrix,
    intrinsics_of,
    level_intrinsics,
    normalized,
    pixel_warp,
    pixels,
    pose_gradient,
    pose_jacobian,
    projection_jacobian,
    to_pixel,
    unproject,
    viewing_rays,
    warp_of,
    warp_offset,
    warp_point,
)

INTRINSICS = np.array([200.0, 215.0, 160.0, 118.0])
CAMERA = Intrinsics(*INTRINSICS)
T_TARGET_HOST = se3.exp(np.array([0.15, -0.1, 0.08, 0.05, -0.08, 0.3]))
PIXELS = [(160.0, 118.0), (30.0, 20.0), (300.0, 50.0), (40.0, 220.0), (290.0, 200.0)]
IDEPTHS = [0.2, 1.0, 1.7]
H = 1e-6  # step of numeric derivatives


def point_in_target(u, v, idepth, intrinsics=INTRINSICS, T=T_TARGET_HOST):
    """The point itself in the target's camera, by way of its place in the host's: equation (5) word for word."""
    fx, fy, cx, cy = intrinsics
    return T[:3, :3] @ (np.array([(u - cx) / fx, (v - cy) / fy, 1.0]) / idepth) + T[:3, 3]


def pixel_of(point, intrinsics=INTRINSICS):
    fx, fy, cx, cy = intrinsics
    return np.array([fx * point[0] / point[2] + cx, fy * point[1] / point[2] + cy])


def numeric(function, steps):
    """Columns (f(+h e) - f(-h e)) / 2 h."""
    return np.stack([(function(H * e) - function(-H * e)) / (2 * H) for e in np.eye(steps)], axis=-1)


def pixels_to_pixels(T=T_TARGET_HOST):
    return warp_of(*pixel_warp(intrinsic_matrix(INTRINSICS), intrinsic_inverse(INTRINSICS), T))


def motion(T=T_TARGET_HOST):
    return warp_of(T[:3, :3], T[:3, 3])


def test_intrinsic_matrix_and_inverse():
    K = intrinsic_matrix(INTRINSICS)
    assert K.tolist() == [[200, 0, 160], [0, 215, 118], [0, 0, 1]]
    np.testing.assert_allclose(intrinsic_inverse(INTRINSICS), np.linalg.inv(K), atol=1e-15)


def test_a_level_shows_its_pixels_between_those_of_the_finest():
    """Pixel 0 of level k covers the pixels 0 to 2^k - 1 of level 0, so its centre lies at (2^k - 1) / 2 there."""
    for level in range(4):
        x, y = unproject(Intrinsics(*level_intrinsics(INTRINSICS, level)), 0.0, 0.0)
        centre = (2**level - 1) / 2
        assert (x, y) == pytest.approx(unproject(CAMERA, centre, centre))


@pytest.mark.parametrize(("u", "v"), PIXELS)
def test_unprojection_is_the_inverse_of_projection(u, v):
    x, y = unproject(intrinsics_of(INTRINSICS), u, v)
    np.testing.assert_allclose(INTRINSICS[:2] * [x, y] + INTRINSICS[2:], [u, v])
    assert to_pixel(CAMERA, x, y) == pytest.approx((u, v))


def test_arrays_give_what_kernels_give_point_by_point():
    u, v = np.array(PIXELS).T
    x, y = normalized(CAMERA, u, v)
    for i in range(len(PIXELS)):
        assert (x[i], y[i]) == pytest.approx(unproject(CAMERA, u[i], v[i]))
    np.testing.assert_allclose(pixels(CAMERA, x, y), [u, v])


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
@pytest.mark.parametrize("shape", [(5,), (2, 3), (0,)])
def test_viewing_rays(dtype, shape):
    u, v = np.random.default_rng(0).integers(0, 300, (2, *shape)).astype(dtype)
    rays = viewing_rays(INTRINSICS, u, v)
    assert rays.shape == (*shape, 3)
    assert rays.dtype == np.float64
    pixels = rays @ intrinsic_matrix(INTRINSICS).T
    np.testing.assert_allclose(pixels[..., 0], u, atol=1e-4)
    np.testing.assert_allclose(pixels[..., 1], v, atol=1e-4)
    assert (rays[..., 2] == 1).all()


@pytest.mark.parametrize(("u", "v"), PIXELS)
@pytest.mark.parametrize("idepth", IDEPTHS)
def test_both_warps_show_the_point_where_it_is(u, v, idepth):
    point = point_in_target(u, v, idepth)
    depth = point[2] * idepth  # in units of that in the host

    x, y, z, z_inverse = warp_point(pixels_to_pixels(), u, v, idepth)
    assert (x, y) == pytest.approx(tuple(pixel_of(point)))
    assert (z, z_inverse) == pytest.approx((depth, 1 / depth))

    x, y, z, z_inverse = warp_point(motion(), *unproject(CAMERA, u, v), idepth)
    assert (x, y) == pytest.approx((point[0] / point[2], point[1] / point[2]))
    assert (z, z_inverse) == pytest.approx((depth, 1 / depth))


def test_a_point_behind_the_target_has_a_negative_depth():
    backwards = se3.exp(np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0]))
    assert warp_point(motion(backwards), 0.1, 0.1, 0.5)[2] == pytest.approx(1 - 1.5)
    assert warp_point(motion(backwards), 0.1, 0.1, 0.1)[2] == pytest.approx(1 - 0.3)


@pytest.mark.parametrize("number", [numba.float32, numba.float64])
def test_kernels_compute_in_the_type_of_their_arguments(number):
    """One float64 among float32 would halve the speed of a vectorised loop."""
    camera = numba.types.NamedUniTuple(number, 4, Intrinsics)
    warp = numba.types.NamedUniTuple(number, 12, Warp)
    kernels = {
        unproject: (camera, number, number),
        to_pixel: (camera, number, number),
        warp_point: (warp, number, number, number),
        warp_offset: (warp, number, number),
        epipolar_direction: (warp, number, number),
        pose_gradient: (number,) * 5,
    }
    for kernel, arguments in kernels.items():
        kernel.compile(arguments)
        assert set(kernel.overloads[arguments].signature.return_type) == {number}


@pytest.mark.parametrize(
    ("u", "v", "z", "seen"),
    [
        (50.0, 40.0, 1.0, True),
        (2.5, 2.5, 1.0, True),
        (96.5, 76.5, 1.0, True),
        (1.5, 40.0, 1.0, False),
        (50.0, 1.5, 1.0, False),
        (97.5, 40.0, 1.0, False),
        (50.0, 77.5, 1.0, False),
        (50.0, 40.0, -1.0, False),
        (50.0, 40.0, 0.0, False),
        (np.nan, 40.0, 1.0, False),
        (50.0, np.nan, 1.0, False),
        (50.0, 40.0, np.nan, False),
        (np.inf, 40.0, 1.0, False),
    ],
)
def test_in_view(u, v, z, seen):
    assert bool(in_view(u, v, z, 100, 80)) is seen


@pytest.mark.parametrize(("u", "v"), PIXELS)
@pytest.mark.parametrize("idepth", IDEPTHS)
@pytest.mark.parametrize("along_x", [True, False])
def test_the_inverse_depth_is_found_from_where_a_point_is_seen(u, v, idepth, along_x):
    warp = pixels_to_pixels()
    x, y, _, _ = warp_point(warp, u, v, idepth)
    assert idepth_at(warp, u, v, x, y, along_x) == pytest.approx(idepth)


@pytest.mark.parametrize("idepth", IDEPTHS)
def test_epipolar_direction_is_the_derivative_by_idepth(idepth):
    warp = pixels_to_pixels()
    x, y, z, _ = warp_point(warp, 30.0, 200.0, idepth)
    expected = numeric(lambda e: np.array(warp_point(warp, 30.0, 200.0, idepth + e[0])[:2]), 1)[:, 0]
    np.testing.assert_allclose(np.array(epipolar_direction(warp, x, y)) / z, expected, rtol=1e-6)


def test_offsets_are_exact_where_depths_do_not_change():
    """A turn about the optical axis and a motion across it leave all depths as they are."""
    warp = pixels_to_pixels(se3.exp(np.array([0.1, -0.05, 0.0, 0.0, 0.0, 0.4])))
    here, beside = (np.array(warp_point(warp, u, v, 0.8)[:2]) for u, v in ((100.0, 90.0), (102.0, 87.0)))
    np.testing.assert_allclose(warp_offset(warp, 2.0, -3.0), beside - here, atol=1e-10)


@pytest.mark.parametrize(("u", "v"), PIXELS)
@pytest.mark.parametrize("idepth", IDEPTHS)
def test_pose_jacobian_and_gradient(u, v, idepth):
    point = point_in_target(u, v, idepth)
    expected = numeric(lambda xi: pixel_of(se3.exp(xi)[:3, :3] @ point + se3.exp(xi)[:3, 3]), 6)
    x, y, new_idepth = point[0] / point[2], point[1] / point[2], 1 / point[2]
    jacobian = np.array(pose_jacobian(CAMERA, x, y, new_idepth))
    np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-5)

    image_gradient = np.array([7.0, -4.0])
    gradient = pose_gradient(x, y, new_idepth, *(image_gradient * INTRINSICS[:2]))
    np.testing.assert_allclose(gradient, image_gradient @ jacobian, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("u", "v"), PIXELS)
@pytest.mark.parametrize("idepth", IDEPTHS)
def test_projection_jacobian(u, v, idepth):
    def moved(step):
        T = se3.exp(step[4:10]) @ T_TARGET_HOST
        intrinsics = INTRINSICS + step[:4]
        return pixel_of(point_in_target(u, v, idepth + step[10], intrinsics, T), intrinsics)

    ours = np.array(projection_jacobian(CAMERA, motion(), u, v, idepth)).reshape(2, 11)
    np.testing.assert_allclose(ours, numeric(moved, 11), rtol=1e-5, atol=1e-5)
