# SPDX-License-Identifier: BSD-3-Clause
"""Images that declare more than they are."""

import re
import struct
import zlib

import cv2
import numpy as np
import pytest

from ceiling_dso_ros.io import image_decoding
from ceiling_dso_ros.io.errors import FrameError
from ceiling_dso_ros.io.image_decoding import decode_compressed, decode_image
from ceiling_dso_ros.io.image_headers import declared_size, scans
from ceiling_dso_ros.io.limits import MOST_PIXELS, MOST_SCANS

ENDINGS = (".png", ".jpg", ".bmp", ".tif", ".pgm")
HUGE = 60_000


def image_file(ending, width=37, height=21):
    rng = np.random.default_rng(0)
    return cv2.imencode(ending, rng.integers(0, 255, (height, width), dtype=np.uint8))[1].tobytes()


def huge(ending):
    """A small file that declares an image of 60 000 x 60 000."""
    data = image_file(ending)
    if ending == ".png":
        head = b"IHDR" + struct.pack(">II", HUGE, HUGE) + data[24:29]
        return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]
    if ending == ".jpg":
        at = data.index(b"\xff\xc0") + 5
        return data[:at] + struct.pack(">HH", HUGE, HUGE) + data[at + 4 :]
    if ending == ".bmp":
        return data[:18] + struct.pack("<ii", HUGE, -HUGE) + data[26:]
    if ending == ".pgm":
        return data.replace(b"37 21", b"60000 60000", 1)
    changed = bytearray(data)
    (directory,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, directory)
    for entry in range(directory + 2, directory + 2 + 12 * count, 12):
        if struct.unpack_from("<H", data, entry)[0] in (256, 257):
            struct.pack_into("<HII", changed, entry + 2, 4, 1, HUGE)
    return bytes(changed)


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_size_is_that_of_the_decoded_image(ending):
    data = image_file(ending)
    assert declared_size(data) == (37, 21)
    assert decode_compressed(data).shape == (21, 37)


@pytest.mark.parametrize("options", [[cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 1]])
def test_other_kinds_of_jpeg(options):
    data = cv2.imencode(".jpg", np.zeros((21, 37, 3), np.uint8), options)[1].tobytes()
    assert declared_size(data) == (37, 21)
    assert 1 <= scans(data) <= 20


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_huge_image_is_refused_before_it_is_decoded(ending, monkeypatch):
    data = huge(ending)
    assert len(data) < 2000
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("was decoded"))
    with pytest.raises(FrameError, match=f"^the image is said to be {HUGE}x{HUGE}, more than {MOST_PIXELS} pixels$"):
        decode_compressed(data)


def test_a_huge_message_is_refused_before_memory_is_taken():
    with pytest.raises(FrameError, match=f"said to be {HUGE}x{HUGE}"):
        decode_image("rgb8", HUGE, HUGE, 3 * HUGE, False, b"")


def test_a_jpeg_that_is_drawn_again_and_again():
    data = image_file(".jpg")
    scan = data[data.index(b"\xff\xda") : -2]
    with pytest.raises(FrameError, match=f"damaged image: {MOST_SCANS + 1} scans"):
        decode_compressed(data[:-2] + MOST_SCANS * scan + data[-2:])


def test_a_file_of_more_bytes_than_any_image(monkeypatch):
    monkeypatch.setattr(image_decoding, "MOST_IMAGE_BYTES", 100)
    data = image_file(".png")
    with pytest.raises(FrameError, match=re.escape(f"the image has {len(data)} bytes, more than 100")):
        decode_compressed(data)


def test_formats_whose_size_is_not_known_are_not_decoded():
    data = cv2.imencode(".webp", np.zeros((21, 37, 3), np.uint8))[1].tobytes()
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) is not None
    with pytest.raises(FrameError, match="not a readable image"):
        decode_compressed(data)


@pytest.mark.parametrize("ending", ENDINGS)
def test_truncated_headers_have_no_size(ending):
    data = image_file(ending)
    for length in range(12):
        assert declared_size(data[:length]) in ((0, 0), (37, 21), (37, 2), (3, 0))
