# SPDX-License-Identifier: BSD-3-Clause
"""Decodes grey images from the bytes of messages and files."""

from typing import Dict, NamedTuple, Optional, Union

import cv2
import numpy as np

from ceiling_dso_ros.io.errors import FrameError


class _Layout(NamedTuple):
    dtype: type
    channels: int
    to_grey: Optional[int]  # OpenCV's conversion


LAYOUTS: Dict[str, _Layout] = {
    "mono8": _Layout(np.uint8, 1, None),
    "8UC1": _Layout(np.uint8, 1, None),
    "mono16": _Layout(np.uint16, 1, None),
    "16UC1": _Layout(np.uint16, 1, None),
    "bgr8": _Layout(np.uint8, 3, cv2.COLOR_BGR2GRAY),
    "rgb8": _Layout(np.uint8, 3, cv2.COLOR_RGB2GRAY),
    "bgra8": _Layout(np.uint8, 4, cv2.COLOR_BGRA2GRAY),
    "rgba8": _Layout(np.uint8, 4, cv2.COLOR_RGBA2GRAY),
}


def decode_image(
    encoding: str, height: int, width: int, step: int, is_bigendian: bool, data: Union[bytes, np.ndarray]
) -> np.ndarray:
    """Grey image of the fields of a sensor_msgs/Image.

    Args:
        encoding: a key of LAYOUTS.
        height: pixels.
        width: pixels.
        step: bytes from one row to the next.
        is_bigendian: byte order of 16 bit values.
        data: the rows.

    Returns:
        (height, width) uint8 or uint16; it may share the memory of data.

    Raises:
        FrameError: unknown encoding, or fewer bytes than the size needs.
    """
    if encoding not in LAYOUTS:
        raise FrameError(f"image encoding '{encoding}' is not one of {', '.join(LAYOUTS)}")
    dtype, channels, to_grey = LAYOUTS[encoding]
    row_bytes = width * channels * np.dtype(dtype).itemsize
    if height <= 0 or width <= 0 or step < row_bytes:
        raise FrameError(f"an image of {width}x{height} {encoding} cannot have rows of {step} bytes")
    buffer = np.frombuffer(data, np.uint8)
    if buffer.size < height * step:
        raise FrameError(f"truncated image: {buffer.size} bytes instead of {height * step}")
    rows = buffer[: height * step].reshape(height, step)[:, :row_bytes]
    if dtype is np.uint16:
        return np.ascontiguousarray(rows).view(">u2" if is_bigendian else "<u2").astype(np.uint16, copy=False)
    if to_grey is None:
        return rows
    return cv2.cvtColor(np.ascontiguousarray(rows).reshape(height, width, channels), to_grey)


def decode_compressed(data: Union[bytes, np.ndarray]) -> np.ndarray:
    """Grey image of the bytes of a JPEG, PNG or other image file.

    Returns:
        (H, W) uint8, or uint16 if the file has 16 bits.

    Raises:
        FrameError: the bytes are no image, or not all of one.
    """
    data = bytes(data)
    if _is_truncated(data):
        raise FrameError(f"truncated image: its {len(data)} bytes have no end mark")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        image = None
    if image is None:
        raise FrameError(f"not a readable image ({len(data)} bytes)")
    return image


def _is_truncated(data: bytes) -> bool:
    """JPEG and PNG decoders fill what is missing with grey, so the end mark has to be looked for."""
    if data.startswith(b"\xff\xd8"):  # neither mark occurs within image data
        start_of_scan, end_of_image = data.rfind(b"\xff\xda"), data.rfind(b"\xff\xd9")
        return end_of_image <= start_of_scan
    return data.startswith(b"\x89PNG") and b"IEND" not in data
