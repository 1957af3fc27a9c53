"""What the tests of several parts need."""

import signal
import struct

import pytest


@pytest.fixture
def interruptible():
    """Python's own answer to Ctrl-C: a suite that a script started in the background inherits that it is ignored."""
    inherited = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, inherited)


@pytest.fixture(scope="session")
def read_ply():
    """Reads the vertices of a binary little endian PLY file, property -> list, by the format's description alone."""
    letters = {"float": "f", "uchar": "B", "int": "i"}

    def read(path):
        header, end, body = path.read_bytes().partition(b"end_header\n")
        magic, encoding, *lines = (line.split() for line in header.decode("ascii").splitlines())
        assert (magic, encoding, end) == (["ply"], ["format", "binary_little_endian", "1.0"], b"end_header\n")
        (count,) = (int(words[2]) for words in lines if words[:2] == ["element", "vertex"])
        properties = {words[2]: letters[words[1]] for words in lines if words[0] == "property"}
        vertices = list(struct.iter_unpack("<" + "".join(properties.values()), body))
        assert len(vertices) == count
        return {name: [vertex[column] for vertex in vertices] for column, name in enumerate(properties)}

    return read
