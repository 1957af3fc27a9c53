# SPDX-License-Identifier: BSD-3-Clause
"""Drives without images: does the adjustment find what was wrong, and how sure is it?"""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_drive import LENS, ROBOT, synthetic_drive

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


@pytest.mark.long
def test_errors_are_about_what_the_covariance_says():
    errors = np.array([deviations(*found_of(seed)) for seed in range(4)])
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6
    assert np.mean(np.abs(errors) < 3.0) > 0.95
