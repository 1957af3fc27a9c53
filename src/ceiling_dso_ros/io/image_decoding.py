# SPDX-License-Identifier: BSD-3-Clause
"""Decodes grey images from the bytes of messages and files."""

import re
import zlib
from contextlib import suppress
from typing import Optional, Union

import cv2
import numpy as np

from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.image_encodings import BAYER_TO_GREY, ENCODINGS, KNOWN, Conversion, finite_floats
from ceiling_dso_ros.io.image_headers import JPEG_SIGNATURE, PNG_SIGNATURE, declared_size, scans
from ceiling_dso_ros.io.limits import MOST_IMAGE_BYTES, MOST_PIXELS, MOST_SCANS

# What is wrong with an image is said once, by the caller: OpenCV would write to stderr for each of them.
cv2.setLogLevel(0)  # silent

# As stored: cameras that look up write any orientation into their files.
AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def decode_image(
    encoding: str, height: int, width: int, step: int, is_bigendian: bool, data: Union[bytes, np.ndarray]
) -> np.ndarray:
    """Grey image of the fields of a sensor_msgs/Image.

    Args:
        encoding: a key of ENCODINGS.
        height: pixels.
        width: pixels.
        step: bytes from one row to the next.
        is_bigendian: byte order of values of several bytes.
        data: the rows; what follows the last one is ignored.

    Returns:
        (height, width) uint8, uint16 or float32; it may share the memory of data.

    Raises:
        FrameError: unknown encoding, fewer bytes than the size needs, or values that are no grey levels.
    """
    if encoding not in ENCODINGS:
        raise FrameError(f"image encoding '{encoding}' cannot be read as grey; those that can: {KNOWN}")
    value, channels, to_grey = ENCODINGS[encoding]
    dtype = np.dtype(f"{'>' if is_bigendian else '<'}{value}")
    row_bytes = width * channels * dtype.itemsize
    if height <= 0 or width <= 0 or step < row_bytes:
        raise FrameError(f"an image of {width}x{height} {encoding} cannot have rows of {step} bytes")
    _require_pixels(width, height)
    buffer = np.frombuffer(data, np.uint8)
    if buffer.size < height * step:
        raise FrameError(f"truncated image: {buffer.size} bytes instead of {height * step}")
    rows = buffer[: height * step].reshape(height, step)[:, :row_bytes]
    if dtype.itemsize > 1 or channels > 1 or to_grey in BAYER_TO_GREY.values():
        rows = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return _grey(to_grey, rows if channels == 1 else rows.reshape(height, width, channels))


def decode_compressed(data: Union[bytes, np.ndarray], image_format: str = "") -> np.ndarray:
    """Grey image of the bytes of a JPEG, PNG, TIFF, BMP or PNM file, not turned by what it says of orientation.

    Args:
        data: the whole file.
        image_format: `format` of a sensor_msgs/CompressedImage: `jpeg`, or as in `bayer_rggb8; png compressed `, where
            the pixels are those of the sensor.

    Returns:
        (H, W) uint8, uint16 if the file has 16 bits, float32 if it has floats.

    Raises:
        FrameError: the bytes are no image, not all of one, one that is too large, or not one of a camera.
    """
    if "compressedDepth" in image_format:
        raise FrameError("a compressedDepth image is a depth image, not one of a camera; name another image topic")
    data = bytes(data)
    require_image_bytes(len(data))
    if _is_truncated(data):
        raise FrameError(f"truncated image: its {len(data)} bytes have no end mark")
    width, height = declared_size(data)
    if width <= 0 or height <= 0:
        raise FrameError(f"not a readable image ({len(data)} bytes)")
    _require_pixels(width, height)
    if scans(data) > MOST_SCANS:
        raise FrameError(f"damaged image: {scans(data)} scans, each of which takes the time of an image")
    if _is_damaged_png(data):
        raise FrameError(f"damaged image: a checksum in its {len(data)} bytes is wrong")
    pattern = re.match("bayer_[a-z]{4}", image_format)
    flags = AS_STORED | (cv2.IMREAD_GRAYSCALE if pattern is None else cv2.IMREAD_ANYCOLOR)
    image: Optional[np.ndarray] = None
    with suppress(cv2.error):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise FrameError(f"not a readable image ({len(data)} bytes)")
    if pattern is not None:
        to_grey = BAYER_TO_GREY.get(pattern[0])
        if image.ndim == 3:  # converted before it was compressed
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        elif to_grey is not None:
            image = _grey(to_grey, image)
    if image.dtype.kind == "f":
        return finite_floats(image)
    if image.dtype not in (np.uint8, np.uint16):
        raise FrameError(f"the image has pixels of {image.dtype} instead of 8 or 16 bits or floats")
    return image


def require_image_bytes(count: int) -> None:
    """Refuse an image file before it is read.

    Raises:
        FrameError: it has more bytes than any image of a camera.
    """
    if count > MOST_IMAGE_BYTES:
        raise FrameError(f"the image has {count} bytes, more than {MOST_IMAGE_BYTES}")


def _require_pixels(width: int, height: int) -> None:
    if width * height > MOST_PIXELS:
        raise FrameError(f"the image is said to be {width}x{height}, more than {MOST_PIXELS} pixels")


def _grey(to_grey: Conversion, image: np.ndarray) -> np.ndarray:
    try:
        return to_grey(image)
    except cv2.error as error:
        height, width = image.shape[:2]
        raise FrameError(f"an image of {width}x{height} pixels cannot be made grey") from error


def _is_truncated(data: bytes) -> bool:
    """JPEG and PNG decoders fill what is missing with grey, so the end mark has to be looked for."""
    if data.startswith(JPEG_SIGNATURE):  # neither mark occurs within image data
        start_of_scan, end_of_image = data.rfind(b"\xff\xda"), data.rfind(b"\xff\xd9")
        return end_of_image <= start_of_scan
    return data.startswith(b"\x89PNG") and b"IEND" not in data


def _is_damaged_png(data: bytes) -> bool:
    """A chunk of a PNG has a wrong checksum; found here, because libpng writes to stderr for each of them."""
    start = len(PNG_SIGNATURE)
    if not data.startswith(PNG_SIGNATURE):
        return False
    while start + 12 <= len(data):  # length, name, content, checksum
        end = start + 8 + int.from_bytes(data[start : start + 4], "big")
        if zlib.crc32(data[start + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return True
        if data[start + 4 : start + 8] == b"IEND":
            return False
        start = end + 4
    return True
