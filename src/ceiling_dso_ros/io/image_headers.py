# SPDX-License-Identifier: BSD-3-Clause
"""What image files say of themselves, read before they are decoded: a file of 100 bytes may ask for gigabytes."""

import struct
from typing import Callable, Dict, Iterator, Tuple

Size = Tuple[int, int]  # width, height

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8"
START_OF_SCAN = 0xDA
# Start of frame: 0xc0 to 0xcf except those that define tables.
STARTS_OF_FRAME = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
# Tags of a TIFF, of the image and of its tiles, and the type of a value of 16 bits.
TIFF_WIDTHS, TIFF_HEIGHTS, TIFF_SHORT = (256, 322), (257, 323), 3
WITHOUT_LENGTH = {0x00, 0x01, *range(0xD0, 0xDA)}


def declared_size(data: bytes) -> Size:
    """Width and height of a JPEG, PNG, BMP, TIFF or PNM file; (0, 0) of other formats, and of damaged files."""
    reader = next((read for signature, read in READERS.items() if data.startswith(signature)), None)
    try:
        return (0, 0) if reader is None else reader(data)
    except (struct.error, ValueError, IndexError):
        return 0, 0


def scans(data: bytes) -> int:
    """How many times a JPEG draws over its pixels; 0 of other formats."""
    return data.count(bytes((0xFF, START_OF_SCAN))) if data.startswith(JPEG_SIGNATURE) else 0


def _of_png(data: bytes) -> Size:
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _of_jpeg(data: bytes) -> Size:
    """The largest of all frames, though there should be one."""
    sizes = [struct.unpack_from(">HH", data, start + 3) for code, start in _segments(data) if code in STARTS_OF_FRAME]
    height, width = max(sizes, key=lambda size: size[0] * size[1], default=(0, 0))
    return width, height


def _segments(data: bytes) -> Iterator[Tuple[int, int]]:
    """Code of each marker up to the first scan, and where its length is."""
    position = data.find(b"\xff", len(JPEG_SIGNATURE))
    while 0 <= position < len(data) - 3:
        code = data[position + 1]
        position += 2
        if code == 0xFF:  # fills up
            position -= 1
        elif code == START_OF_SCAN:
            return
        elif code not in WITHOUT_LENGTH:
            yield code, position
            position += max(struct.unpack_from(">H", data, position)[0], 2)
        position = data.find(b"\xff", position)


def _of_bmp(data: bytes) -> Size:
    width, height = struct.unpack_from("<ii", data, 18)
    return abs(width), abs(height)


def _of_tiff(data: bytes) -> Size:
    """Of the first image, or of its tiles where these are larger."""
    order = "<" if data.startswith(b"II") else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    values: Dict[int, int] = {}
    for entry in range(directory + 2, directory + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", data, entry)
        if tag in (*TIFF_WIDTHS, *TIFF_HEIGHTS):
            (values[tag],) = struct.unpack_from(f"{order}{'H' if kind == TIFF_SHORT else 'I'}", data, entry + 8)
    if not {TIFF_WIDTHS[0], TIFF_HEIGHTS[0]} <= values.keys():
        return 0, 0
    return max(values.get(tag, 0) for tag in TIFF_WIDTHS), max(values.get(tag, 0) for tag in TIFF_HEIGHTS)


def _of_pnm(data: bytes) -> Size:
    lines = (line.split(b"#")[0] for line in data[2:200].splitlines())
    width, height, *_ = b" ".join(lines).split()
    return int(width), int(height)


READERS: Dict[bytes, Callable[[bytes], Size]] = {
    PNG_SIGNATURE: _of_png,
    JPEG_SIGNATURE: _of_jpeg,
    b"BM": _of_bmp,
    b"II*\x00": _of_tiff,
    b"MM\x00*": _of_tiff,
    **{b"P" + digit: _of_pnm for digit in (b"1", b"2", b"3", b"4", b"5", b"6")},
}
