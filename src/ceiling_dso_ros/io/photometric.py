# SPDX-License-Identifier: BSD-3-Clause
"""Photometric calibration: from raw grey levels to the irradiance of the scene, equation (2) of the paper."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Optional, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.grey_range import GREY_LEVELS
from ceiling_dso_ros.io.image_decoding import decode_compressed
from ceiling_dso_ros.io.text_files import read_lines

WHITE = np.float32(GREY_LEVELS - 1)


@dataclass(frozen=True)
class PhotometricCalibration:
    """Response and vignetting of a camera.

    The camera turns the irradiance B of a pixel x into the raw value G(t V(x) B(x)), equation (1); t is the exposure
    time.

    Attributes:
        inverse_response: (256,) float64, G^-1 of each grey level, not decreasing, from 0 to 255.
        vignette: (H, W) float32 V in (0, 1], or None where V = 1 everywhere.
    """

    inverse_response: np.ndarray
    vignette: Optional[np.ndarray] = None

    @classmethod
    def linear(cls) -> "PhotometricCalibration":
        """A camera of linear response without vignetting, equation (12)."""
        return cls(np.arange(GREY_LEVELS, dtype=np.float64))

    def correct(self, image: np.ndarray, units: float = 256.0) -> np.ndarray:
        """Apply equation (2), I = G^-1(raw) / V = t B.

        Args:
            image: (H, W) uint8, uint16 or float32.
            units: how many units of the values of uint16 and float32 images make one grey level, see `GreyRange`;
                256 where all 16 bits are used.

        Returns:
            (H, W) float32, a new array; 0 to 255 where the vignette is 1.
        """
        corrected: np.ndarray
        if image.dtype == np.uint8:
            table = self.inverse_response.astype(np.float32)
            corrected = image.astype(np.float32) if self._is_linear else cv2.LUT(image, table)
        else:
            corrected = np.clip(image * np.float32(1.0 / units), np.float32(0.0), WHITE)
            if not self._is_linear:
                corrected = np.interp(corrected, np.arange(GREY_LEVELS), self.inverse_response).astype(np.float32)
        if self._gain is not None:
            corrected *= self._gain
        return corrected

    @cached_property
    def _is_linear(self) -> bool:
        return np.array_equal(self.inverse_response, np.arange(GREY_LEVELS))

    @cached_property
    def _gain(self) -> Optional[np.ndarray]:
        return None if self.vignette is None else 1.0 / self.vignette


def read_photometric(
    pcalib_path: Optional[Path], vignette_path: Optional[Path], size: Tuple[int, int]
) -> PhotometricCalibration:
    """Read the photometric files of a TUM-mono folder.

    Args:
        pcalib_path: `pcalib.txt`, the 256 values of G^-1 in any unit; None for a linear response.
        vignette_path: `vignette.png` of 8 or 16 bits, V in any unit; None for no vignetting.
        size: (width, height) of the raw images.

    Raises:
        InputError: the file cannot be read or describes no camera.
    """
    calibration = PhotometricCalibration.linear()
    response = calibration.inverse_response if pcalib_path is None else _read_inverse_response(Path(pcalib_path))
    vignette = None if vignette_path is None else _read_vignette(Path(vignette_path), size)
    return PhotometricCalibration(response, vignette)


def _read_inverse_response(path: Path) -> np.ndarray:
    words = [word for _, line in read_lines(path) for word in line.split()]
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{path}: {error}; expected the {GREY_LEVELS} values of the inverse response") from error
    if len(values) != GREY_LEVELS:
        raise InputError(f"{path}: {len(values)} values instead of the {GREY_LEVELS} of the inverse response")
    if not np.isfinite(values).all():
        raise InputError(f"{path}: value {np.flatnonzero(~np.isfinite(values))[0] + 1} is not finite")
    falls = np.flatnonzero(np.diff(values) < 0)
    if len(falls) or values[0] == values[-1]:
        where = f"falls after value {falls[0] + 1}" if len(falls) else "is constant"
        raise InputError(f"{path}: the inverse response {where}; it must grow with the grey level")
    return (values - values[0]) * (255.0 / (values[-1] - values[0]))


def _read_vignette(path: Path, size: Tuple[int, int]) -> np.ndarray:
    try:
        raw = decode_compressed(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot read the file: {error.strerror}") from error
    except FrameError as error:
        raise InputError(f"{path}: {error}; delete the file if there is no vignetting") from error
    height, width = raw.shape
    if (width, height) != tuple(size):
        raise InputError(f"{path}: the vignette is {width}x{height}, but images are {size[0]}x{size[1]}")
    if raw.min() == 0:
        raise InputError(f"{path}: {np.count_nonzero(raw == 0)} pixels are 0; no light would reach them")
    return (raw / raw.max()).astype(np.float32)
