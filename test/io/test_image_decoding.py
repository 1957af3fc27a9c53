# SPDX-License-Identifier: BSD-3-Clause
import re
import struct

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


OPENCVS_TYPES = {"8UC3": "bgr", "8UC4": "bgra", "16UC3": "bgr", "16UC4": "bgra"}
COLOURS = [f"{order}{bits}" for order in ("bgr", "rgb", "bgra", "rgba") for bits in (8, 16)]


@pytest.mark.parametrize("is_bigendian", [False, True])
@pytest.mark.parametrize("encoding", [*COLOURS, *OPENCVS_TYPES])
def test_colour_becomes_luminance(encoding, is_bigendian):
    order, dtype = OPENCVS_TYPES.get(encoding, encoding.rstrip("168")), np.uint16 if "16" in encoding else np.uint8
    image = random_image(len(order), dtype)
    data, step = rows_with_padding(image.astype(np.dtype(dtype).newbyteorder(">" if is_bigendian else "<")))
    channel = {name: image[:, :, index].astype(float) for index, name in enumerate(order)}
    luminance = 0.299 * channel["r"] + 0.587 * channel["g"] + 0.114 * channel["b"]  # ITU-R BT.601
    decoded = decode_image(encoding, HEIGHT, WIDTH, step, is_bigendian, data)
    assert decoded.dtype == dtype
    np.testing.assert_allclose(decoded, luminance, atol=0.6 if dtype is np.uint8 else 5)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_the_mosaic_of_a_sensor_becomes_luminance(pattern, bits):
    """One colour everywhere: what differs from pixel to pixel is the filter alone."""
    dtype = np.uint8 if bits == 8 else np.uint16
    colour = {name: value << (bits - 8) for name, value in (("r", 200), ("g", 120), ("b", 30))}
    mosaic = np.empty((HEIGHT, WIDTH), dtype)
    for index, name in enumerate(pattern):
        mosaic[index // 2 :: 2, index % 2 :: 2] = colour[name]
    data, step = rows_with_padding(mosaic)
    decoded = decode_image(f"bayer_{pattern}{bits}", HEIGHT, WIDTH, step, False, data)
    assert decoded.dtype == dtype
    luminance = 0.299 * colour["r"] + 0.587 * colour["g"] + 0.114 * colour["b"]
    np.testing.assert_allclose(decoded, luminance, atol=1.1 if bits == 8 else 20)


@pytest.mark.parametrize(("encoding", "first"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)])
def test_luminance_between_colours(encoding, first):
    pairs = random_image(2)
    data, step = rows_with_padding(pairs)
    np.testing.assert_array_equal(decode_image(encoding, HEIGHT, WIDTH, step, False, data), pairs[:, :, first])


@pytest.mark.parametrize("encoding", ["nv12", "nv21", "nv24"])
def test_luminance_before_colours(encoding):
    image = random_image(1)
    data, step = rows_with_padding(image)
    colours = b"\x80" * (step * HEIGHT // 2)
    np.testing.assert_array_equal(decode_image(encoding, HEIGHT, WIDTH, step, False, data + colours), image)


@pytest.mark.parametrize("is_bigendian", [False, True])
@pytest.mark.parametrize(("encoding", "dtype"), [("32FC1", np.float32), ("64FC1", np.float64)])
def test_floats(encoding, dtype, is_bigendian):
    image = np.random.default_rng(2).uniform(0, 1, (HEIGHT, WIDTH)).astype(np.float32)
    data, step = rows_with_padding(image.astype(np.dtype(dtype).newbyteorder(">" if is_bigendian else "<")))
    decoded = decode_image(encoding, HEIGHT, WIDTH, step, is_bigendian, data)
    assert decoded.dtype == np.float32
    np.testing.assert_array_equal(decoded, image)


def test_a_depth_image_is_none_of_a_camera():
    image = np.full((HEIGHT, WIDTH), 2.5, np.float32)
    image[2, 3] = np.nan
    with pytest.raises(FrameError, match="pixels that are not finite, as depth images have"):
        decode_image("32FC1", HEIGHT, WIDTH, 4 * WIDTH, False, image.tobytes())
    with pytest.raises(FrameError, match="pixels that are not finite, as depth images have"):
        decode_compressed(encode(".tiff", image))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"encoding": "8SC1"}, "image encoding '8SC1' cannot be read as grey; those that can: mono, rgb, bgr"),
        ({"data": bytes(59)}, "truncated image: 59 bytes instead of 60"),
        ({"step": 9}, "an image of 10x6 mono8 cannot have rows of 9 bytes"),
        ({"encoding": "bgr16", "step": 59}, "an image of 10x6 bgr16 cannot have rows of 59 bytes"),
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


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_padding_after_a_file_is_harmless(suffix):
    assert decode_compressed(encode(suffix, a_picture()) + bytes(500)).shape == (60, 80)


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_nothing_but_the_error_tells_of_damaged_bytes(suffix, capfd):
    """Libraries would write lines of their own to stderr."""
    damaged = bytearray(encode(suffix, a_picture()))
    if suffix == ".png":
        damaged[len(damaged) // 2] ^= 0xFF
    else:
        damaged = damaged[: len(damaged) // 2]
    with pytest.raises(FrameError, match=r"damaged image: a checksum in its|not a readable image"):
        decode_compressed(bytes(damaged))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("data", [b"", b"no image", b"\x89PNG IEND"])
def test_bytes_of_no_image(data):
    with pytest.raises(FrameError, match=rf"not a readable image \({len(data)} bytes\)"):
        decode_compressed(data)


def with_orientation(jpeg, orientation):
    """A JPEG whose EXIF says how it is to be turned."""
    entry = struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)
    exif = b"Exif\0\0II*\0" + struct.pack("<IH", 8, 1) + entry + struct.pack("<I", 0)
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]


@pytest.mark.parametrize("image_format", ["jpeg", "bayer_rggb8; jpeg compressed "])
def test_the_orientation_in_a_file_does_not_turn_the_image(image_format):
    jpeg = encode(".jpg", a_picture())
    turned = with_orientation(jpeg, 6)
    assert cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (80, 60), "it says so"
    np.testing.assert_array_equal(decode_compressed(turned, image_format), decode_compressed(jpeg, image_format))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_compressed_mosaic_is_that_of_the_sensor(dtype):
    """image_transport compresses it as it is, unless it has converted it to colours."""
    mosaic = a_picture(dtype)
    decoded = decode_compressed(encode(".png", mosaic), f"bayer_grbg{8 * mosaic.itemsize}; png compressed ")
    np.testing.assert_array_equal(decoded, cv2.cvtColor(mosaic, cv2.COLOR_BayerGB2GRAY))
    colour = decode_compressed(encode(".png", np.dstack([mosaic] * 3)), "bayer_grbg8; png compressed bgr8")
    np.testing.assert_array_equal(colour, mosaic)


def test_float_files():
    image = (a_picture() / np.float32(255)).astype(np.float32)
    np.testing.assert_array_equal(decode_compressed(encode(".tiff", image)), image)


def test_a_compressed_depth_image_is_refused():
    data = b"\0" * 12 + encode(".png", a_picture(np.uint16))
    with pytest.raises(FrameError, match="a compressedDepth image is a depth image, not one of a camera"):
        decode_compressed(data, "16UC1; compressedDepth png")


def test_an_image_that_opencv_cannot_convert_concerns_itself_only():
    """OpenCV has an error of its own for it; in a node that cost the map."""
    data = cv2.imencode(".tiff", np.ones((4, 6), np.float32))[1].tobytes()
    with pytest.raises(FrameError, match="an image of 6x4 pixels cannot be made grey"):
        decode_compressed(data, "bayer_rggb8; tiff compressed ")
