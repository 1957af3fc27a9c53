# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of several parts need."""

import os
import shutil
import signal
import struct
import tempfile

import pytest

# As the package does, but some tests import numpy first: threads of OpenBLAS only wait for each other here.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# May name folders of the user.
LEADING_HOME = (
    "MPLCONFIGDIR",
    "PYTHONUSERBASE",
    "ROS_HOME",
    "ROS_LOG_DIR",
    "XDG_CACHE_HOME",
    "XDG_CONFIG_HOME",
    "XDG_DATA_HOME",
    "XDG_STATE_HOME",
)


def pytest_configure(config):
    """Each process of a run has an empty home folder of its own, before it imports what is to be tested.

    evo, matplotlib and ROS make files in the home folder. The user's stays as it is, and no two workers of pytest-xdist
    make the same file at the same moment.
    """
    home = tempfile.mkdtemp(prefix="ceiling_dso_home_")
    # A process of ROS that is still ending may write its log there.
    config.add_cleanup(lambda: shutil.rmtree(home, ignore_errors=True))
    environment = pytest.MonkeyPatch()
    config.add_cleanup(environment.undo)
    environment.setenv("HOME", home)
    for name in LEADING_HOME:
        environment.delenv(name, raising=False)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Workers take the files in the order of the collection."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class InOrder(LoadFileScheduling):
        """Else those with the most tests come first, and the longest, which have few, at the end."""

        def _assign_work_unit(self, node):
            files = map(self._split_scope, self.collection)
            self.workqueue.move_to_end(next(file for file in files if file in self.workqueue), last=False)
            super()._assign_work_unit(node)

    return InOrder(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Files with long tests come first, the longest at the head: at the end, all workers are busy with short ones."""
    minutes = dict.fromkeys((item.path for item in items), 0)
    for item in items:
        for marker in item.iter_markers("long"):
            minutes[item.path] = max(minutes[item.path], marker.kwargs.get("minutes", 1))
    items.sort(key=lambda item: -minutes[item.path])


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
