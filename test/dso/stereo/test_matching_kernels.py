# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from stereo_pair import BASELINE_M, CAMERA, Plane, scattered, side_by_side

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.stereo.matching_kernels import FURTHEST, correlations, match

DISPARITIES = (2.0, 4.25, 6.5, 8.75, 11.1)  # pixels, of a flat ceiling


def found_in(left, right, rig, u, v, idepth, camera=CAMERA):
    """Inverse depths, pixels per 1/m, and standard deviations that `match` finds."""
    outputs = np.zeros((3, u.size))
    match(
        left.ravel(), camera.width, camera.height, right.ravel(), rig.right.width, rig.right.height,
        *rig.warp(camera.matrix), u, v, idepth, *outputs,
    )  # fmt: skip
    return outputs


def flat(disparity, seed=0):
    return Plane((0.0, 0.0, disparity / (CAMERA.fx * BASELINE_M)), seed)


def noisy(image, sigma, rng):
    return image + rng.normal(0.0, sigma, image.shape).astype(np.float32)


@pytest.mark.parametrize("disparity", DISPARITIES)
@pytest.mark.parametrize("gain, offset", [(1.0, 0.0), (0.7, 30.0)])
def test_places_have_no_error_in_common(disparity, gain, offset):
    """Whatever the fraction of a pixel, and with other gains; noise is that of a dark image."""
    rig, rng = side_by_side(), np.random.default_rng(1)
    errors, sigmas = [], []
    for seed in range(4):
        plane = flat(disparity, seed)
        left = noisy(plane.seen_by(CAMERA), 2.0, rng)
        right = noisy(gain * plane.seen_by(rig.right, rig.T_left_right) + offset, gain * 2.0, rng)
        u, v = scattered(CAMERA, 1500, rng)
        truth = plane.inverse_depth(CAMERA, u, v)
        found, reach, sigma = found_in(left, right, rig, u, v, truth * 1.03)
        good = np.isfinite(found)
        assert good.mean() > 0.7
        errors.append(((found - truth) * reach)[good])
        sigmas.append(sigma[good])
    errors, sigmas = np.concatenate(errors), np.concatenate(sigmas)
    weights = sigmas**-2
    assert abs(np.sum(weights * errors) / np.sum(weights)) < 0.006
    assert np.sqrt(np.median((errors / sigmas) ** 2) / 0.455) == pytest.approx(1.0, abs=0.15)


def test_a_second_camera_of_another_lens_that_is_turned_and_a_slanted_ceiling():
    other = PinholeCamera(190.0, 195.0, 150.0, 118.0, 300, 236)
    rig = side_by_side(other, turn=np.array([0.01, -0.02, 0.03]))
    plane = Plane((0.05, -0.03, 0.3))
    left, right = plane.seen_by(CAMERA), plane.seen_by(other, rig.T_left_right)
    u, v = scattered(CAMERA, 1500, np.random.default_rng(2), border=20.0)
    truth = plane.inverse_depth(CAMERA, u, v)
    found, reach, _ = found_in(left, right, rig, u, v, truth * 0.98)
    errors = ((found - truth) * reach)[np.isfinite(found)]
    assert errors.size > 1000
    assert abs(np.median(errors)) < 0.004
    assert np.median(np.abs(errors)) < 0.05


def test_what_has_no_texture_or_is_not_in_the_image_or_far_from_its_place_is_not_found():
    rig, plane = side_by_side(), flat(8.0)
    left, right = plane.seen_by(CAMERA), plane.seen_by(rig.right, rig.T_left_right)
    u, v = np.array([100.0, 3.0, 9.0], np.float32), np.array([100.0, 100.0, 100.0], np.float32)
    idepth = plane.inverse_depth(CAMERA, u, v)
    found, _, _ = found_in(left, right, rig, u, v, idepth)
    assert np.isfinite(found[0]) and np.isnan(found[1:]).all()  # the third is at x = 1 in the right image
    grey = np.full_like(left, 90.0)
    assert np.isnan(found_in(grey, grey, rig, u, v, idepth)[0]).all()
    stripes = np.tile(100.0 + 40.0 * np.sin(np.arange(CAMERA.height) / 2.0)[:, None], CAMERA.width).astype(np.float32)
    assert np.isnan(found_in(stripes, stripes, rig, u, v, idepth)[0]).all()  # along the line nothing changes
    far, _, _ = found_in(left, right, rig, u[:1], v[:1], idepth[:1] * (1.0 + 1.5 * FURTHEST / 8.0))
    assert not abs(far[0] - idepth[0]) < 1e-3


def test_patches_fit_best_at_the_true_scale():
    rig, plane = side_by_side(), flat(8.0)
    left, right = plane.seen_by(CAMERA), plane.seen_by(rig.right, rig.T_left_right)
    u, v = scattered(CAMERA, 100, np.random.default_rng(0), border=30.0)
    scales = 4.0 * np.exp(np.linspace(-0.5, 0.5, 21))
    fits = correlations(
        left.ravel(), CAMERA.width, right.ravel(), CAMERA.width, CAMERA.height, *rig.warp(CAMERA.matrix), u, v,
        (4.0 * plane.inverse_depth(CAMERA, u, v)).astype(np.float32), scales,
    )  # fmt: skip
    assert np.argmax(np.nanmean(fits, axis=1)) == 10
    assert np.nanmean(fits[10]) > 0.99
