# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from stereo_pair import CAMERA, Plane, scattered, side_by_side

from ceiling_dso_ros.dso.config import RigConfig
from ceiling_dso_ros.dso.status import NO_SCALE
from ceiling_dso_ros.dso.stereo.rig import StereoRig
from ceiling_dso_ros.dso.stereo.scale_finder import ScaleFinder, SeenPoints

EXACT = RigConfig(baseline_sigma=0.0, disparity_sigma=0.0)


def seen_points(plane, metres_per_unit, rng, count=900, sigma=0.02):
    u, v = scattered(CAMERA, count, rng, border=4.0)
    idepth = metres_per_unit * plane.inverse_depth(CAMERA, u, v) * (1.0 + sigma * rng.normal(size=count))
    return SeenPoints(u, v, idepth.astype(np.float32), np.arange(count))


def pair(plane, rig, rng, noise=2.0):
    images = plane.seen_by(CAMERA), plane.seen_by(rig.right, rig.T_left_right)
    return [image + rng.normal(0.0, noise, image.shape).astype(np.float32) for image in images]


def measure(finder, left, right, points, smooth=False, known=None):
    return finder.measure(left, CAMERA.matrix, right, smooth, points, known)


@pytest.mark.parametrize("depth_m", [1.5, 4.0, 9.0])
@pytest.mark.parametrize("metres_per_unit", [0.3, 4.0])
def test_the_scale_is_found_without_a_guess(depth_m, metres_per_unit):
    rig, rng, plane = side_by_side(), np.random.default_rng(3), Plane((0.0, 0.02 / depth_m, 1.0 / depth_m))
    found = measure(ScaleFinder(rig, EXACT), *pair(plane, rig, rng), seen_points(plane, metres_per_unit, rng))
    error = found.log_scale - np.log(metres_per_unit)
    assert abs(error) < 4.0 * found.sigma < 0.03
    assert found.common_sigma == 0.0


def test_errors_agree_with_the_standard_deviation():
    rig = side_by_side()
    squares = []
    for seed in range(40):
        rng, plane = np.random.default_rng(seed), Plane((0.01, 0.0, 0.22), seed)
        found = measure(ScaleFinder(rig, EXACT), *pair(plane, rig, rng), seen_points(plane, 4.0, rng))
        squares.append(((found.log_scale - np.log(4.0)) / found.sigma) ** 2)
    assert 0.4 < np.mean(squares) < 1.8


def test_the_second_image_is_smoothed_like_the_first():
    from ceiling_dso_ros.dso.images.noise import smooth_image

    rig, rng, plane = side_by_side(), np.random.default_rng(3), Plane((0.0, 0.0, 0.2))
    left, right = pair(plane, rig, rng)
    smoothed = np.empty_like(left)
    smooth_image(left, np.empty_like(left), smoothed)
    kept = right.copy()
    found = measure(ScaleFinder(rig, EXACT), smoothed, right, seen_points(plane, 4.0, rng), smooth=True)
    assert abs(found.log_scale - np.log(4.0)) < 4.0 * found.sigma
    np.testing.assert_array_equal(right, kept)


def test_the_same_points_in_the_next_keyframe_tell_nothing_new():
    rig, rng, plane = side_by_side(), np.random.default_rng(3), Plane((0.0, 0.0, 0.2))
    left, right = pair(plane, rig, rng)
    points, finder = seen_points(plane, 4.0, rng), ScaleFinder(rig, EXACT)
    first = measure(finder, left, right, points)
    again = points._replace(name=np.where(np.arange(900) < 600, points.name, points.name + 1000))
    second = measure(finder, left, right, again)
    assert second.sigma == pytest.approx(np.sqrt(3.0) * first.sigma, rel=0.1)
    assert measure(finder, left, right, again) is NO_SCALE
    assert measure(ScaleFinder(rig, EXACT), left, right, again) == first


def test_a_ceiling_that_repeats_itself_or_another_view_or_none_tells_nothing():
    rig, rng, plane = side_by_side(), np.random.default_rng(3), Plane((0.0, 0.0, 0.2))
    points = seen_points(plane, 4.0, rng)
    x = np.arange(CAMERA.width)
    stripes = np.tile(120.0 + 40.0 * np.sin(2 * np.pi * x / 8.0), (CAMERA.height, 1)).astype(np.float32)
    assert measure(ScaleFinder(rig, EXACT), stripes, stripes, points) is NO_SCALE
    left, _ = pair(plane, rig, rng)
    _, other = pair(Plane((0.0, 0.0, 0.2), seed=9), rig, rng)
    assert measure(ScaleFinder(rig, EXACT), left, other, points) is NO_SCALE
    assert measure(ScaleFinder(rig, EXACT), left, np.zeros_like(left), points) is NO_SCALE
    assert measure(ScaleFinder(rig, EXACT), left, other, points, known=4.0) is NO_SCALE
    few = SeenPoints(*(array[:10] for array in points))
    assert measure(ScaleFinder(rig, EXACT), left, other, few) is NO_SCALE


def test_where_a_roof_repeats_itself_the_known_scale_tells_which_place_is_meant():
    rig, rng = side_by_side(), np.random.default_rng(3)
    plane = Plane((0.0, 0.0, 12.0 / (CAMERA.fx * 0.095)))  # 12 pixels: one and a half periods
    x = np.arange(CAMERA.width)
    row = 120.0 + 40.0 * np.sin(2 * np.pi * x / 8.0)
    shifted = 120.0 + 40.0 * np.sin(2 * np.pi * (x + 12.0) / 8.0)
    left, right = (np.tile(each, (CAMERA.height, 1)).astype(np.float32) for each in (row, shifted))
    points = seen_points(plane, 4.0, rng, sigma=0.01)
    assert measure(ScaleFinder(rig, EXACT), left, right, points) is NO_SCALE
    for wrong in (0.9, 1.0, 1.1):
        found = measure(ScaleFinder(rig, EXACT), left, right, points, known=wrong * 4.0)
        assert found.log_scale == pytest.approx(np.log(4.0), abs=0.003)


def test_a_known_scale_that_is_wrong_is_found_to_be_so():
    rig, rng, plane = side_by_side(), np.random.default_rng(3), Plane((0.0, 0.0, 0.2))
    left, right = pair(plane, rig, rng)
    points = seen_points(plane, 4.0, rng)
    expected = measure(ScaleFinder(rig, EXACT), left, right, points)
    for known in (1.0, 3.0, 6.0, 8.0):
        found = measure(ScaleFinder(rig, EXACT), left, right, points, known=known)
        assert found.log_scale == pytest.approx(expected.log_scale, abs=0.1 * expected.sigma)


@pytest.mark.parametrize("T", [np.eye(4), np.full((4, 4), np.nan), np.diag([1.0, 1.0, 2.0, 1.0]), np.eye(3)])
def test_a_pose_that_tells_no_depth_is_refused(T):
    with pytest.raises(ValueError, match="second camera"):
        StereoRig(CAMERA, T)
