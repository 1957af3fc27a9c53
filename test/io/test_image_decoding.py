# SPDX-License-Identifier: BSD-3-Clause
import re

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.image_decoding import decode_compressed, decode_image

HEIGHT, WIDTH, PADDING = 6, 10, 3


def rows_with_padding(image):
    """Bytes and step of an image whose rows are followed by some bytes of no meaning."""
    rows = np.ascontiguousarray(image).view(np.uint8).reshape(HEIGHT, -1)
    padded = np.hstack([rows, np.full((HEIGHT, PADDING), 99, np.uint8)])
    return padded.tobytes(), padded.shape[1]


def random_image(channels, dtype=np.uint8):
    shape = (HEIGHT, WIDTH, channels) if channels > 1 else (HEIGHT, WIDTH)
    return np.random.default_rng(2).integers(0, np.iinfo(dtype).max, shape, dtype=dtype)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_eight_bit_grey(encoding):
    image = random_image(1)
    data, step = rows_with_padding(image)
    np.testing.assert_array_equal(decode_image(encoding, HEIGHT, WIDTH, step, False, data), image)


@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
@pytest.mark.parametrize("is_bigendian", [False, True])
def test_sixteen_bit_grey_in_both_byte_orders(encoding, is_bigendian):
    image = random_image(1, np.uint16)
    data, step = rows_with_padding(image.astype(">u2" if is_bigendian else "<u2"))
    decoded = decode_image(encoding, HEIGHT, WIDTH, step, is_bigendian, data)
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, image)


@pytest.mark.parametrize(
    ("encoding", "order"), [("bgr8", "bgr"), ("rgb8", "rgb"), ("bgra8", "bgra"), ("rgba8", "rgba")]
)
def test_colour_becomes_luminance(encoding, order):
    image = random_image(len(order))
    data, step = rows_with_padding(image)
    channel = {name: image[:, :, index].astype(float) for index, name in enumerate(order)}
    luminance = 0.299 * channel["r"] + 0.587 * channel["g"] + 0.114 * channel["b"]  # ITU-R BT.601
    decoded = decode_image(encoding, HEIGHT, WIDTH, step, False, data)
    assert decoded.dtype == np.uint8
    np.testing.assert_allclose(decoded, luminance, atol=0.6)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"encoding": "bayer_rggb8"}, "image encoding 'bayer_rggb8' is not one of mono8, 8UC1, mono16, 16UC1, bgr8"),
        ({"data": bytes(59)}, "truncated image: 59 bytes instead of 60"),
        ({"step": 9}, "an image of 10x6 mono8 cannot have rows of 9 bytes"),
        ({"height": 0}, "an image of 10x0 mono8 cannot have rows of 10 bytes"),
    ],
)
def test_bad_images_are_explained(changes, complaint):
    fields = {"encoding": "mono8", "height": HEIGHT, "width": WIDTH, "step": WIDTH, "is_bigendian": False}
    fields = {**fields, "data": bytes(60), **changes}
    with pytest.raises(FrameError, match=re.escape(complaint)):
        decode_image(**fields)


def encode(suffix, image):
    return cv2.imencode(suffix, image)[1].tobytes()


def a_picture(dtype=np.uint8):
    x, y = np.meshgrid(np.arange(80), np.arange(60))
    return ((np.sin(x / 9) + np.cos(y / 7) + 2) / 4 * np.iinfo(dtype).max).astype(dtype)


def test_compressed_images_keep_their_depth():
    np.testing.assert_array_equal(decode_compressed(encode(".png", a_picture())), a_picture())
    np.testing.assert_array_equal(decode_compressed(encode(".png", a_picture(np.uint16))), a_picture(np.uint16))
    jpeg = decode_compressed(np.frombuffer(encode(".jpg", a_picture()), np.uint8))
    assert np.abs(jpeg.astype(int) - a_picture()).max() < 12
    colour = decode_compressed(encode(".png", np.dstack([a_picture()] * 3)))
    assert colour.shape == (60, 80)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_a_truncated_file_is_no_image(suffix, share):
    data = encode(suffix, a_picture())
    with pytest.raises(FrameError, match=r"truncated image: its \d+ bytes have no end mark"):
        decode_compressed(data[: int(share * len(data))])


def test_padding_after_a_jpeg_is_harmless():
    assert decode_compressed(encode(".jpg", a_picture()) + bytes(500)).shape == (60, 80)


@pytest.mark.parametrize("data", [b"", b"no image", b"\x89PNG IEND"])
def test_bytes_of_no_image(data):
    with pytest.raises(FrameError, match=rf"not a readable image \({len(data)} bytes\)"):
        decode_compressed(data)
