# SPDX-License-Identifier: BSD-3-Clause
"""The encodings of sensor_msgs/Image that can be read as grey images."""

from functools import partial
from typing import Callable, Dict, NamedTuple

import cv2
import numpy as np

from ceiling_dso_ros.io.errors import FrameError

Conversion = Callable[[np.ndarray], np.ndarray]


class Encoding(NamedTuple):
    """How the rows of an image are to be read.

    Attributes:
        value: kind and bytes of a value as numpy writes them, without the byte order: u1, u2, f4, f8.
        channels: values of each pixel.
        to_grey: from (height, width) values, with several channels (height, width, channels), to a grey image
            (height, width) uint8, uint16 or float32.
    """

    value: str
    channels: int
    to_grey: Conversion


def _converted(code: int) -> Conversion:
    return partial(cv2.cvtColor, code=code)


def _unchanged(image: np.ndarray) -> np.ndarray:
    return image


def _first(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[:, :, 0])


def _second(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[:, :, 1])


def finite_floats(image: np.ndarray) -> np.ndarray:
    """An image of floats as float32.

    Raises:
        FrameError: a pixel is not finite, as in depth images.
    """
    image = image.astype(np.float32, copy=False)
    if not np.isfinite(image).all():
        raise FrameError("the image has pixels that are not finite, as depth images have")
    return image


# OpenCV names a pattern after the second and third pixel of the second row, ROS after the first four.
BAYER_TO_GREY = {
    "bayer_rggb": _converted(cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr": _converted(cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg": _converted(cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg": _converted(cv2.COLOR_BayerGB2GRAY),
}
_BGR, _RGB = _converted(cv2.COLOR_BGR2GRAY), _converted(cv2.COLOR_RGB2GRAY)
_BGRA, _RGBA = _converted(cv2.COLOR_BGRA2GRAY), _converted(cv2.COLOR_RGBA2GRAY)
_OF_BYTES_AND_WORDS = {
    "mono": (1, _unchanged),
    "bgr": (3, _BGR),
    "rgb": (3, _RGB),
    "bgra": (4, _BGRA),
    "rgba": (4, _RGBA),
}

ENCODINGS: Dict[str, Encoding] = {
    **{f"{name}8": Encoding("u1", *how) for name, how in _OF_BYTES_AND_WORDS.items()},
    **{f"{name}16": Encoding("u2", *how) for name, how in _OF_BYTES_AND_WORDS.items()},
    **{f"{name}8": Encoding("u1", 1, to_grey) for name, to_grey in BAYER_TO_GREY.items()},
    **{f"{name}16": Encoding("u2", 1, to_grey) for name, to_grey in BAYER_TO_GREY.items()},
    # The channels of OpenCV's types have OpenCV's order.
    **{f"8UC{channels}": Encoding("u1", channels, how) for channels, how in ((1, _unchanged), (3, _BGR), (4, _BGRA))},
    **{f"16UC{channels}": Encoding("u2", channels, how) for channels, how in ((1, _unchanged), (3, _BGR), (4, _BGRA))},
    "32FC1": Encoding("f4", 1, finite_floats),
    "64FC1": Encoding("f8", 1, finite_floats),
    # Two bytes for each pixel, one of them the luminance. ROS means UYVY by yuv422.
    "yuv422": Encoding("u1", 2, _second),
    "uyvy": Encoding("u1", 2, _second),
    "yuv422_yuy2": Encoding("u1", 2, _first),
    "yuyv": Encoding("u1", 2, _first),
    # The luminance in whole rows, the colours in further rows that follow.
    "nv12": Encoding("u1", 1, _unchanged),
    "nv21": Encoding("u1", 1, _unchanged),
    "nv24": Encoding("u1", 1, _unchanged),
}  # fmt: skip
KNOWN = (
    "mono, rgb, bgr, rgba and bgra with 8 or 16 bits, bayer_*8, bayer_*16, yuv422, yuv422_yuy2, nv12, nv21, nv24, "
    "8UC1, 8UC3, 8UC4, 16UC1, 16UC3, 16UC4, 32FC1, 64FC1"
)
