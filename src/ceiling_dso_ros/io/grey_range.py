# SPDX-License-Identifier: BSD-3-Clause
"""The range of grey levels of images with more than 8 bits, as a setting or found from the images."""

from collections import deque
from typing import Callable, Deque, Optional

import numpy as np

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.warning_log import ignore_warning

GREY_LEVELS = 256  # what the odometry's thresholds mean
DEPTHS = (8, 10, 12, 14, 16)  # bits of the sensors and analogue-to-digital converters that there are
MOST_BITS = DEPTHS[-1]
NORMALIZED_UNITS = 1.0 / (GREY_LEVELS - 1)  # of float images from 0 to 1
# A larger range is believed if so many images in a row have it: not a single one with damaged pixels.
BELIEVED = 3


def check_bits(bits: int, name: str) -> None:
    """Refuse a bit depth that no image has.

    Args:
        bits: of white in 16 bit and float images, 0 to find it from the images.
        name: of the option or parameter.

    Raises:
        InputError: it is neither 0 nor from 8 to 16.
    """
    if bits != 0 and not DEPTHS[0] <= bits <= MOST_BITS:
        raise InputError(f"{name} {bits}: {DEPTHS[0]} to {MOST_BITS}, or 0 to find it from the images")


class GreyRange:
    """How many units of an image's values make one of 256 grey levels.

    Drivers deliver the 10, 12 or 14 bits of a sensor in messages of 16 bits, and no message says how many there are. So
    if no bit depth is given, the smallest one is taken that the brightest pixels fit in. Three images in a row decide,
    and later ones can only enlarge it. Images of 8 bits have one unit for each level.
    """

    def __init__(self, bits: int = 0, tell: Callable[[str], None] = ignore_warning) -> None:
        """Begin.

        Args:
            bits: the bit depth, 0 to find it from the images.
            tell: is told in one line what was found, and when an image is brighter than bits allow.
        """
        self._given = _units_of_bits(bits) if bits else None
        self._bits = bits
        self._tell = tell
        self._recent: Deque[float] = deque(maxlen=BELIEVED)
        self._units: Optional[float] = None  # settled
        self._was_too_bright = False

    def units(self, image: np.ndarray) -> float:
        """Units of one grey level of the next image, (H, W) uint8, uint16 or float32."""
        if image.dtype == np.uint8:
            return 1.0
        brightest = float(image.max())
        if self._given is not None:
            if brightest >= GREY_LEVELS * self._given and not self._was_too_bright:
                self._was_too_bright = True
                self._tell(
                    f"an image has values up to {brightest:g}, more than {self._bits} bits allow: they are white"
                )
            return self._given
        self._recent.append(_smallest_units(brightest, is_float=image.dtype.kind == "f"))
        agreed = min(self._recent)
        if len(self._recent) < BELIEVED:
            return agreed
        if self._units is None or agreed > self._units:
            self._units = agreed
            self._tell(
                f"the images have values up to {brightest:g}, so white is taken to be {_name(agreed)}; "
                "a given bit depth (--bits, bit_depth) overrides that"
            )
        return self._units


def _units_of_bits(bits: int) -> float:
    return float(2**bits) / GREY_LEVELS


def _smallest_units(brightest: float, is_float: bool) -> float:
    if is_float and brightest <= 1.0:
        return NORMALIZED_UNITS
    return next((_units_of_bits(bits) for bits in DEPTHS if brightest < 2**bits), _units_of_bits(MOST_BITS))


def _name(units: float) -> str:
    if units == NORMALIZED_UNITS:
        return "1"
    white = int(units * GREY_LEVELS)
    return f"{white - 1} ({white.bit_length() - 1} bits)"
