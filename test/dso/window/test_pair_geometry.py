# SPDX-License-Identifier: BSD-3-Clause
"""Relative geometry and brightness against projecting points one by one."""

import numpy as np
import pytest
from synthetic import AFFINES, EXPOSURES, POSES, RELIEF, true_window

from ceiling_dso_ros.dso.geometry import se3
from ceiling_dso_ros.dso.geometry.projection import intrinsic_matrix
from ceiling_dso_ros.dso.window.pair_geometry import pair_geometry, project_points

PAIRS = [(h, t) for h in range(3) for t in range(3) if h != t]


@pytest.fixture(scope="module")
def moved():
    """A window that has moved from its evaluation point, and the step."""
    window = true_window(2)
    step = 0.01 * np.random.default_rng(0).normal(size=28)
    window.move(step)
    return window, step, pair_geometry(window.keyframes, 3, window.intrinsics)


@pytest.mark.parametrize(("host", "target"), PAIRS)
def test_projection_of_a_point(moved, host, target):
    window, _, pairs = moved
    K = intrinsic_matrix(window.intrinsics)
    point_host = np.array([0.2, -0.3, 1.4])
    pixel = K @ point_host / point_host[2]
    T = window.keyframes.T_camera_world[target] @ np.linalg.inv(window.keyframes.T_camera_world[host])
    expected = K @ (T[:3, :3] @ point_host + T[:3, 3])
    ours = pairs.KRKi[host, target] @ pixel + pairs.Kt[host, target] / point_host[2]
    np.testing.assert_allclose(ours[:2] / ours[2], expected[:2] / expected[2], atol=1e-3)
    assert ours[2] == pytest.approx(expected[2] / point_host[2], rel=1e-5)


@pytest.mark.parametrize(("host", "target"), PAIRS)
def test_brightness_transfer(moved, host, target):
    """Both images show the same light x: I = exposure e^a x + b."""
    window, _, pairs = moved
    light = 100.0
    seen = [
        EXPOSURES[k] * np.exp(window.keyframes.affine[k, 0]) * light + window.keyframes.affine[k, 1] for k in range(3)
    ]
    assert pairs.gain[host, target] * seen[host] + pairs.offset[host, target] == pytest.approx(seen[target], rel=1e-5)


@pytest.mark.parametrize(("host", "target"), PAIRS)
def test_evaluation_point_stays(moved, host, target):
    _, _, pairs = moved
    T = POSES[target] @ np.linalg.inv(POSES[host])
    np.testing.assert_allclose(pairs.R_eval[host, target], T[:3, :3], atol=1e-6)
    np.testing.assert_allclose(pairs.t_eval[host, target], T[:3, 3], atol=1e-6)
    np.testing.assert_allclose(pairs.adjoint_eval[host, target], se3.adjoint(T), atol=1e-12)
    ratio = EXPOSURES[target] / EXPOSURES[host] * np.exp(AFFINES[target][0] - AFFINES[host][0])
    assert pairs.gain_eval[host, target] == pytest.approx(ratio, rel=1e-6)


def test_projection_into_the_newest_keyframe():
    window = true_window(30, surface=RELIEF)
    pairs = pair_geometry(window.keyframes, 3, window.intrinsics)
    p = window.points.arrays
    x, y, idepth = (np.empty(90, np.float32) for _ in range(3))
    project_points(p.u[:90], p.v[:90], p.idepth[:90], p.host[:90], pairs, 2, x, y, idepth)
    np.testing.assert_allclose(idepth, RELIEF.idepth(POSES[2], x, y), rtol=1e-4)
    np.testing.assert_array_equal(x[60:], p.u[60:90])
    assert np.abs(x[:60] - p.u[:60]).min() > 0.5
