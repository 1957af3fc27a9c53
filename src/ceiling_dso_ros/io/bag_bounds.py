# SPDX-License-Identifier: BSD-3-Clause
"""A reader of ROS 1 bags that takes no more memory than the file and one of its chunks need, whatever they declare."""

import bz2
from typing import Any, BinaryIO, Callable, Dict, Optional, Union

import lz4.frame
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import Chunk

from ceiling_dso_ros.io.limits import MOST_CHUNK_BYTES


class BoundedFile:
    """An open file from which no more is asked for than it has."""

    def __init__(self, file: BinaryIO) -> None:
        self.size = file.seek(0, 2)
        self.bytes_read = 0
        self._file = file
        file.seek(0)

    def read(self, count: int) -> bytes:
        """Read some bytes, fewer at the end of the file."""
        if count > self.size:
            raise ReaderError(f"a record declares {count} bytes, and the file has {self.size}")
        data = self._file.read(count)
        self.bytes_read += len(data)
        return data

    def readline(self) -> bytes:
        """Read a line, or the first thousand bytes of it."""
        return self._file.readline(1000)

    def seek(self, position: int, whence: int = 0) -> int:
        """Go to a place."""
        return self._file.seek(position, whence)

    def tell(self) -> int:
        """Where it is."""
        return self._file.tell()

    def close(self) -> None:
        """Close it."""
        self._file.close()


class BoundedReader(Reader):
    """`Reader` of rosbags, which opens `bio`, reads the whole index of the file, and then chunk by chunk."""

    _bounded: Optional[BoundedFile] = None

    @property
    def bio(self) -> Any:  # noqa: ANN401 to rosbags it is a BinaryIO, of which it has what it calls
        """The open file."""
        return self._bounded

    @bio.setter
    def bio(self, file: Optional[BinaryIO]) -> None:
        self._bounded = None if file is None else BoundedFile(file)

    def read_index_data(self, pos: int, indexes: Dict[int, list]) -> None:
        """Read the index of a chunk; no place of the file can be that of many chunks, as their memory would add up."""
        super().read_index_data(pos, indexes)
        if self._bounded is not None and self._bounded.bytes_read > self._bounded.size:
            raise ReaderError("chunks share their index")

    def read_chunk(self) -> Chunk:
        """Read the head of a chunk."""
        chunk = super().read_chunk()
        return chunk._replace(decompressor=BOUNDED.get(chunk.decompressor, chunk.decompressor))


def _of_bz2(data: bytes) -> bytes:
    return _decompressed(data, bz2.BZ2Decompressor())


def _of_lz4(data: bytes) -> bytes:
    return _decompressed(data, lz4.frame.LZ4FrameDecompressor())


def _decompressed(data: bytes, decompressor: Union[bz2.BZ2Decompressor, lz4.frame.LZ4FrameDecompressor]) -> bytes:
    """The content of a chunk.

    Raises:
        ReaderError: it is larger than any chunk is.
    """
    content: bytes = decompressor.decompress(data, MOST_CHUNK_BYTES)
    if not decompressor.eof:
        raise ReaderError(f"a compressed chunk has more than {MOST_CHUNK_BYTES} bytes, or is not complete")
    return content


# Function that rosbags calls -> what is called instead.
BOUNDED: Dict[Callable[[bytes], bytes], Callable[[bytes], bytes]] = {
    bz2.decompress: _of_bz2,
    lz4.frame.decompress: _of_lz4,
}
