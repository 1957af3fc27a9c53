# SPDX-License-Identifier: BSD-3-Clause
"""Drives without images: does the adjustment find what was wrong, and how sure is it?"""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_drive import LENS, ROBOT, synthetic_drive

from ceiling_dso_ros.fusion.calibration import CalibrationError
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.lens.calibrating import NEEDLESS
from ceiling_dso_ros.lens.checking import fits, misfit
from ceiling_dso_ros.lens.finding import find, in_calibration_order, mount_angles
from ceiling_dso_ros.lens.parameters import vector_of, with_vector

WRONG = np.array([1.5, 1.0, 2.5, -2.0, 0.02, 0.0])


def found_of(seed, wrong=WRONG, **settings):
    drive = synthetic_drive(seed, **settings)
    lens = with_vector(LENS, vector_of(LENS) + wrong)
    guess = replace(ROBOT, T_base_camera=drive.T_base_camera)
    return drive, find(drive.keyframes, drive.tracks, drive.steps, ROBOT, guess, lens, lens)


def deviations(drive, found):
    values, covariance = in_calibration_order(found)
    true = [*vector_of(LENS), *mount_angles(drive.T_base_camera), *drive.T_base_camera[:2, 3], 0.0, 0.0, 0.0]
    return (values - true) / np.sqrt(np.diag(covariance))


@pytest.fixture(scope="module")
def drives():
    return [found_of(seed) for seed in range(3)]


@pytest.mark.long
def test_errors_are_about_what_the_covariance_says(drives):
    errors = np.array([deviations(*drive) for drive in drives])
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.5
    assert np.mean(np.abs(errors) < 3.0) > 0.95


@pytest.mark.long
def test_lens_and_mount_are_told_apart(drives):
    for drive, found in drives:
        change = vector_of(found.state.lens) - vector_of(LENS)
        assert np.abs(change[2:4]).max() < 0.3  # pixels
        assert np.abs(change[4:]).max() < 3e-3
        assert np.abs(found.state.T_base_camera[:2, 3] - drive.T_base_camera[:2, 3]).max() < 4e-3
        assert found.slips == ()


@pytest.mark.long
def test_a_lens_that_does_not_fit_is_named(drives):
    _, found = drives[0]
    line = misfit(found, with_vector(LENS, vector_of(LENS) + WRONG))
    assert "cx -2." in line and "cy +" in line and "k1 -0.0" in line and "fx" not in line
    assert misfit(found, LENS) is None
    assert fits(found, LENS, NEEDLESS)
    assert not fits(found, with_vector(LENS, vector_of(LENS) + WRONG), NEEDLESS)


@pytest.mark.long
def test_a_lens_that_is_hardly_another_one_stays(drives):
    """However sure the drive is of it: half a pixel costs nothing."""
    _, found = drives[0]
    sure = replace(found, covariance=1e-6 * found.covariance)
    for shift_px, stays in (((0.3, 0.2), True), ((0.5, 0.4), False)):
        shifted = replace(found.state.lens, cx=found.state.lens.cx + shift_px[0], cy=found.state.lens.cy + shift_px[1])
        assert fits(sure, shifted, NEEDLESS) == stays


@pytest.mark.long
def test_a_fov_lens_and_a_slip():
    """Of one coefficient alone; the left wheel turns 5 cm too far."""
    lens = LensCamera("FOV", 220.0, 220.0, 212.0, 120.0, (0.8,), 424, 240)
    drive = synthetic_drive(5, lens=lens, slip_m=0.05)
    wrong = with_vector(lens, vector_of(lens) + np.array([0.0, 0.0, 2.0, -2.0, 0.02, 0.0]))
    guess = replace(ROBOT, T_base_camera=drive.T_base_camera)
    found = find(drive.keyframes, drive.tracks, drive.steps, ROBOT, guess, wrong, wrong)
    change = vector_of(found.state.lens) - vector_of(lens)
    assert np.abs(change[2:4]).max() < 0.4
    assert change[4] == pytest.approx(0.0, abs=0.005)
    assert change[5] == 0.0
    assert [slip.what.startswith("the left wheel turned 0.05") for slip in found.slips] == [True]
    assert found.left_out < 6


def test_a_drive_that_is_too_short_is_refused():
    drive = synthetic_drive(0, duration_s=4.0)
    with pytest.raises(CalibrationError, match="--keep-lens"):
        find(drive.keyframes, drive.tracks, drive.steps, ROBOT, ROBOT, LENS, LENS)
