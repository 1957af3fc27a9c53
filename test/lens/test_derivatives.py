# SPDX-License-Identifier: BSD-3-Clause
"""All derivatives against numeric ones."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_drive import LENS, ROBOT, synthetic_drive

from ceiling_dso_ros.fusion.calibration_data import WheelPath
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.finding import _wheel_pairs
from ceiling_dso_ros.lens.floor import floor_terms
from ceiling_dso_ros.lens.parameters import (
    by_parameters,
    by_ray,
    correctable,
    names_of,
    pixels_of,
    rays_of,
    vector_of,
    with_vector,
)  # fmt: skip
from ceiling_dso_ros.lens.sightings import derivatives, residuals
from ceiling_dso_ros.lens.state import OF_DRIVE, DriveState
from ceiling_dso_ros.lens.tracks import Tracks

LENSES = {
    "RadTan": LENS,
    "rational": replace(LENS, distortion=(0.1, -0.05, 1e-3, -5e-4, 0.01, 0.08, 0.01, 0.0)),
    "EquiDistant": LensCamera("EquiDistant", 200.0, 201.0, 210.0, 119.0, (0.01, -0.02, 0.0, 0.0), 424, 240),
    "FOV": LensCamera("FOV", 220.0, 220.0, 212.0, 120.0, (0.8,), 424, 240),
}
STEP = 1e-6


@pytest.fixture(scope="module")
def drive():
    return synthetic_drive(0, duration_s=4.0)


@pytest.fixture(scope="module")
def state(drive):
    tracks = drive.tracks
    pixel = tracks.host_pixel
    ray = rays_of(LENS, pixel, tracks.host_ray)
    return DriveState(
        LENS, drive.T_base_camera, np.array([0.003, 0.002, -0.004]), drive.T_world_base, pixel, ray, tracks.idepth / 4.0
    )


def moved(state, number, size):
    """The state after a step of one unknown, in the order of `state`."""
    keyframes, points = len(state.T_world_base), len(state.idepth)
    step = np.zeros(OF_DRIVE + 6 * keyframes + 3 * points)
    step[number] = size
    of_drive, of_keyframes, of_points = np.split(step, [OF_DRIVE, OF_DRIVE + 6 * keyframes])
    return state.moved(of_drive, of_keyframes.reshape(-1, 6), of_points.reshape(-1, 3))


def numeric(function, state, number):
    return (function(moved(state, number, STEP)) - function(moved(state, number, -STEP))) / (2 * STEP)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_a_lens_by_rays_and_by_its_numbers(lens):
    rays = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 2))
    pixels = pixels_of(lens, rays)
    np.testing.assert_allclose(rays_of(lens, pixels, rays + 0.02), rays, atol=1e-9)
    for axis, step in enumerate(STEP * np.eye(2)):
        np.testing.assert_allclose(
            by_ray(lens, rays)[:, :, axis], (pixels_of(lens, rays + step) - pixels) / STEP, atol=1e-3
        )
    vector, found = vector_of(lens), by_parameters(lens, rays)
    for number in range(6):
        other = with_vector(lens, vector + 1e-6 * np.eye(6)[number])
        np.testing.assert_allclose(found[:, :, number], (pixels_of(other, rays) - pixels) / 1e-6, atol=1e-3)
    assert names_of(lens)[4] == ("omega" if lens.model == "FOV" else "k1")


def test_a_pinhole_gets_coefficients_and_stays_the_same():
    pinhole = LensCamera("Pinhole", 212.0, 212.0, 213.0, 118.0, (), 424, 240)
    rays = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 2))
    np.testing.assert_array_equal(pixels_of(correctable(pinhole), rays), pixels_of(pinhole, rays))


def test_sightings(drive, state):
    found, tracks = derivatives(state, drive.tracks), drive.tracks

    def function(state):
        return residuals(state, tracks)[0]

    for number in range(12):
        np.testing.assert_allclose(
            found.of_camera[:, :, number], numeric(function, state, number), atol=2e-3, err_msg=number
        )
    host, target = tracks.host[tracks.point], tracks.target
    for keyframe in (0, 3, 7):
        for axis in range(6):
            change = numeric(function, state, OF_DRIVE + 6 * keyframe + axis)
            np.testing.assert_allclose(change[host == keyframe], found.of_host[host == keyframe, :, axis], atol=2e-3)
            np.testing.assert_allclose(
                change[target == keyframe], found.of_target[target == keyframe, :, axis], atol=2e-3
            )
            assert np.abs(change[(host != keyframe) & (target != keyframe)]).max() == 0.0
    for point in (0, 40):
        mine = tracks.point == point
        for axis in range(3):
            change = numeric(function, state, OF_DRIVE + 6 * len(state.T_world_base) + 3 * point + axis)
            np.testing.assert_allclose(change[mine], found.of_point[mine, :, axis], atol=2e-3)
            assert np.abs(change[~mine]).max() == 0.0


@pytest.mark.parametrize("what", ["floor", "wheels"])
def test_floor_and_wheels(drive, state, what):
    wheels = _wheel_pairs(drive.keyframes, WheelPath(drive.steps, ROBOT.wheel_base_m))
    sigmas, weights = np.array([0.002, 0.003, 0.004]), np.linspace(0.5, 1.0, len(wheels.pairs))

    def terms_of(state):
        return (
            floor_terms(state, sigmas, OF_DRIVE) if what == "floor" else wheels.terms(state, sigmas, weights, OF_DRIVE)
        )

    terms = terms_of(state)
    dense = np.zeros((*terms.residual.shape, OF_DRIVE + 6 * len(state.T_world_base)))
    for n, index in enumerate(terms.unknowns):
        dense[n][:, index] = terms.derivative[n]
    for number in (*range(OF_DRIVE), *range(OF_DRIVE + 6, OF_DRIVE + 24)):
        expected = numeric(lambda state: terms_of(state).residual, state, number)
        np.testing.assert_allclose(dense[:, :, number], expected, atol=1e-4 * max(1.0, np.abs(expected).max()))


def test_tracks_know_the_point_of_each_sighting(drive):
    tracks: Tracks = drive.tracks
    assert len(tracks.point) == len(tracks.target)
    assert (tracks.host[tracks.point] < tracks.target).all()
