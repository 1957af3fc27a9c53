# SPDX-License-Identifier: BSD-3-Clause
import re

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.photometric import PhotometricCalibration, read_photometric

SIZE = (64, 48)


def gamma_inverse_response():
    """G^-1 of a response G(x) = 255 (x / 255)^(1 / 2.2)."""
    return 255 * (np.arange(256) / 255) ** 2.2


def a_vignette():
    x, y = np.meshgrid(np.linspace(-1, 1, SIZE[0]), np.linspace(-1, 1, SIZE[1]))
    vignette = 1 - 0.3 * (x * x + y * y)
    return vignette / vignette.max()


def write_pcalib(path, values):
    path.write_text(" ".join(f"{value:.9f}" for value in values))
    return path


def write_vignette(path, vignette, dtype=np.uint16):
    cv2.imwrite(str(path), np.round(vignette * np.iinfo(dtype).max).astype(dtype))
    return path


@pytest.mark.parametrize("bits", [8, 16])
def test_correction_inverts_the_camera(tmp_path, bits):
    """Equation (2) undoes equation (1): t B comes back within the quantisation of the raw image."""
    rng = np.random.default_rng(5)
    irradiance, exposure = rng.uniform(2, 25, (SIZE[1], SIZE[0])), 10.0
    attenuated = exposure * a_vignette() * irradiance
    response = 255 * (attenuated / 255) ** (1 / 2.2)
    raw = np.round(response).astype(np.uint8) if bits == 8 else np.round(response * 256).astype(np.uint16)

    calibration = read_photometric(
        write_pcalib(tmp_path / "pcalib.txt", gamma_inverse_response()),
        write_vignette(tmp_path / "vignette.png", a_vignette()),
        SIZE,
    )
    corrected = calibration.correct(raw)

    assert corrected.dtype == np.float32
    slope = np.diff(gamma_inverse_response()).max()
    tolerance = slope / 2 / a_vignette().min() if bits == 8 else 0.02
    np.testing.assert_allclose(corrected, exposure * irradiance, atol=1.05 * tolerance)


def test_every_grey_level_is_corrected_exactly():
    vignette = np.full((16, 16), 0.5, np.float32)
    raw = np.arange(256, dtype=np.uint8).reshape(16, 16)
    corrected = PhotometricCalibration(gamma_inverse_response(), vignette).correct(raw)
    np.testing.assert_allclose(corrected.ravel(), gamma_inverse_response() / 0.5, rtol=1e-6)


def test_linear_correction_is_a_conversion_to_a_new_array():
    raw = np.arange(256, dtype=np.uint8).reshape(16, 16)
    linear = PhotometricCalibration.linear()
    corrected = linear.correct(raw)
    assert corrected.dtype == np.float32
    np.testing.assert_array_equal(corrected, raw)
    assert linear.correct(raw) is not corrected


def test_sixteen_bits_span_the_same_grey_levels_as_eight():
    raw = np.array([[0, 256, 384, 65280, 65535]], np.uint16)
    np.testing.assert_array_equal(PhotometricCalibration.linear().correct(raw), [[0, 1, 1.5, 255, 255]])


def test_files_of_any_unit_are_scaled(tmp_path):
    pcalib = write_pcalib(tmp_path / "pcalib.txt", 3 + gamma_inverse_response() / 7)
    vignette = write_vignette(tmp_path / "vignette.png", 0.5 * a_vignette(), np.uint8)
    calibration = read_photometric(pcalib, vignette, SIZE)
    np.testing.assert_allclose(calibration.inverse_response, gamma_inverse_response(), atol=1e-4)
    assert calibration.vignette.max() == 1.0
    np.testing.assert_allclose(calibration.vignette, a_vignette(), atol=0.01)


def test_no_files_mean_linear():
    calibration = read_photometric(None, None, SIZE)
    np.testing.assert_array_equal(calibration.inverse_response, np.arange(256))
    assert calibration.vignette is None


def with_value(index, value):
    values = gamma_inverse_response()
    values[index] = value
    return values


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        (np.arange(255), "255 values instead of the 256 of the inverse response"),
        (with_value(100, np.nan), "value 101 is not finite"),
        (with_value(100, -5), "the inverse response falls after value 100; it must grow with the grey level"),
        (np.ones(256), "the inverse response is constant; it must grow with the grey level"),
    ],
)
def test_responses_of_no_camera(tmp_path, values, complaint):
    path = write_pcalib(tmp_path / "pcalib.txt", values)
    with pytest.raises(InputError, match=re.escape(f"{path}: {complaint}")):
        read_photometric(path, None, SIZE)


def test_a_response_that_is_not_numbers(tmp_path):
    path = tmp_path / "pcalib.txt"
    path.write_text("0 1 two")
    with pytest.raises(InputError, match=re.escape(f"{path}: could not convert string to float: 'two'; expected the")):
        read_photometric(path, None, SIZE)


@pytest.mark.parametrize(
    ("vignette", "complaint"),
    [
        (np.ones((40, 40)), "the vignette is 40x40, but images are 64x48"),
        (np.where(a_vignette() < 0.45, 0, a_vignette()), "pixels are 0; no light would reach them"),
    ],
)
def test_vignettes_of_no_camera(tmp_path, vignette, complaint):
    path = write_vignette(tmp_path / "vignette.png", vignette)
    with pytest.raises(InputError, match=rf"{re.escape(str(path))}: (\d+ )?{complaint}"):
        read_photometric(None, path, SIZE)


def test_a_vignette_that_is_no_image(tmp_path):
    path = tmp_path / "vignette.png"
    path.write_text("no image")
    with pytest.raises(
        InputError, match=re.escape(f"{path}: not a readable image (8 bytes); delete the file if there is no")
    ):
        read_photometric(None, path, SIZE)
