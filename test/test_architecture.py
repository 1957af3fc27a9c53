# SPDX-License-Identifier: BSD-3-Clause
"""Imports run one way, libraries stay in their rooms, files and folders stay small."""

import ast
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = "ceiling_dso_ros"
SOURCE = ROOT / "src" / PACKAGE

# Each imports only from those above it; names in one row know nothing of each other.
LAYERS = (
    ("version",),
    ("__init__", "dso"),
    ("fusion",),
    ("io",),
    ("drivers",),
    ("slam",),
    ("settings",),
    ("playback",),
    ("evaluation", "simulation", "lidar", "lens"),
    ("experiments",),
    ("cli", "ros"),
    ("__main__",),
)
# The rooms of the odometry, in the same way. The first row are files that say what goes in, how time is counted, and
# what comes out.
ROOMS_OF_DSO = (
    ("config", "durations", "hosted_points"),
    ("status",),
    ("compute",),
    ("geometry",),
    ("images",),
    ("stereo",),
    ("window",),
    ("adjustment",),
    ("tracking",),
    ("mapping",),
    ("start",),
    ("segment",),
    ("odometry",),
    ("warmup",),
    ("__init__",),  # offers what is in the rooms
)
# Of the odometry, io and drivers know no more than what a camera is.
A_CAMERA = (f"{PACKAGE}.dso.geometry.camera", f"{PACKAGE}.dso.geometry.projection")
ALL_THEY_IMPORT = {
    "io": (f"{PACKAGE}.io", *A_CAMERA),
    "drivers": (f"{PACKAGE}.drivers", f"{PACKAGE}.io", *A_CAMERA),
    "settings": (f"{PACKAGE}.io", f"{PACKAGE}.dso.config"),
}
ROS = (
    *("rospy", "rosgraph", "roslib", "genpy", "tf2_ros", "diagnostic_updater", "dynamic_reconfigure"),
    *("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs", "diagnostic_msgs", "rosgraph_msgs", "tf2_msgs"),
    *("std_srvs", f"{PACKAGE}.msg", f"{PACKAGE}.srv", f"{PACKAGE}.cfg"),
)
# Library -> the layers that may import it.
LIBRARIES = {
    **dict.fromkeys(ROS, ("ros",)),
    "distributed": ("experiments",),
    "evo": (),
    "filterpy": ("fusion",),
    "gtsam": ("fusion", "slam", "lidar"),
    "gtsam_unstable": ("fusion", "slam"),
    "matplotlib": ("evaluation", "experiments"),
    "omegaconf": ("settings",),
    "pyrealsense2": ("drivers",),
    "rosbags": ("io",),
}
LIBRARIES_OF_DSO = ("numpy", "numba", "llvmlite")

LONGEST_FILE = 350  # lines; a longer one gives its reason in a line of its docstring that begins with LONG_BECAUSE
LONG_BECAUSE = "Long because"
LARGEST_ROOM = 12  # files
WITH_ROOMS = ("dso", "lidar", "simulation")

FILES = sorted(SOURCE.rglob("*.py"))
NODES = sorted((ROOT / "nodes").iterdir())


def imported_names(source):
    """Dotted names of all that is imported anywhere in a file, also inside functions; `from a import b` gives a.b."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import in line {node.lineno}: imports here give the whole name"
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def is_within(name, package):
    return name == package or name.startswith(f"{package}.")


def child_of(name, package):
    """The part of a dotted name that follows the package's; None if the name is not within it."""
    return name[len(package) + 1 :].split(".")[0] if name.startswith(f"{package}.") else None


def dotted(path):
    return ".".join((PACKAGE, *path.relative_to(SOURCE).with_suffix("").parts))


def upward_imports(name, imported, package, order):
    """Those of the imported names that the module `name` may not import, by the order of the package's children."""
    rank = {child: row for row, children in enumerate(order) for child in children}
    own = child_of(name, package)
    assert own in rank, f"{name}: say in test_architecture.py which layer {own} is"
    return [
        other
        for other in sorted(imported)
        if child_of(other, package) not in (None, own) and rank.get(child_of(other, package), -1) >= rank[own]
    ]


def foreign_imports(layer, imported):
    """Those of the imported names that belong to a library which the layer may not import."""
    return [
        name
        for name in sorted(imported)
        for library, layers in LIBRARIES.items()
        if is_within(name, library) and layer not in layers
    ]


def reads(path):
    return pytest.param(path, id=str(path.relative_to(ROOT)))


@pytest.mark.parametrize("path", map(reads, FILES))
def test_imports_run_downward(path):
    imported = imported_names(path.read_text())
    assert upward_imports(dotted(path), imported, PACKAGE, LAYERS) == []
    if is_within(dotted(path), f"{PACKAGE}.dso"):
        assert upward_imports(dotted(path), imported, f"{PACKAGE}.dso", ROOMS_OF_DSO) == []


@pytest.mark.parametrize("path", map(reads, FILES))
def test_libraries_stay_in_their_layers(path):
    imported = imported_names(path.read_text())
    layer = child_of(dotted(path), PACKAGE)
    assert foreign_imports(layer, imported) == []
    if layer in ALL_THEY_IMPORT:
        ours = [name for name in imported if is_within(name, PACKAGE)]
        assert [name for name in ours if not any(is_within(name, known) for known in ALL_THEY_IMPORT[layer])] == []


def is_of_python(library):
    found = importlib.util.find_spec(library)
    return found is not None and not {"site-packages", "dist-packages"} & {*Path(str(found.origin)).parts}


def test_the_odometry_needs_arrays_and_a_compiler_and_nothing_else():
    found = {name.split(".")[0] for path in (SOURCE / "dso").rglob("*.py") for name in imported_names(path.read_text())}
    assert {name for name in found - {PACKAGE} if not is_of_python(name)} == {*LIBRARIES_OF_DSO}


@pytest.mark.parametrize("path", map(reads, NODES))
def test_nodes_hold_no_mathematics(path):
    ours = [name for name in imported_names(path.read_text()) if is_within(name, PACKAGE)]
    assert [name for name in ours if not is_within(name, f"{PACKAGE}.ros")] == []


@pytest.mark.parametrize("path", map(reads, FILES))
def test_long_files_say_why(path):
    text = path.read_text()
    lines = len(text.splitlines())
    if lines > LONGEST_FILE:
        head = ast.get_docstring(ast.parse(text)) or ""
        assert re.search(f"^{LONG_BECAUSE}", head, re.MULTILINE), (
            f"{lines} lines: split it, or begin a line of its head"
        )


@pytest.mark.parametrize(
    "folder", map(reads, sorted({path.parent for path in FILES if path.relative_to(SOURCE).parts[0] in WITH_ROOMS}))
)
def test_rooms_are_small(folder):
    assert len(list(folder.glob("*.py"))) <= LARGEST_ROOM


def test_what_these_tests_would_find():
    lazy = "def f():\n    from ceiling_dso_ros.fusion.planar import wrap\n    import rospy, gtsam.symbol_shorthand\n"
    imported = imported_names(lazy)
    assert imported == {"ceiling_dso_ros.fusion.planar.wrap", "rospy", "gtsam.symbol_shorthand"}
    assert upward_imports("ceiling_dso_ros.io.bag", imported, PACKAGE, LAYERS) == []
    assert upward_imports("ceiling_dso_ros.dso.odometry", imported, PACKAGE, LAYERS) == [
        "ceiling_dso_ros.fusion.planar.wrap"
    ]
    assert foreign_imports("fusion", imported) == ["rospy"]
    assert foreign_imports("ros", imported) == ["gtsam.symbol_shorthand"]
    beside = imported_names("from ceiling_dso_ros import ros, __version__")
    assert upward_imports("ceiling_dso_ros.cli.main", beside, PACKAGE, LAYERS) == ["ceiling_dso_ros.ros"]
    assert upward_imports("ceiling_dso_ros.dso.images.pyramid", {"ceiling_dso_ros.dso.window.points.POINTS"},
                          "ceiling_dso_ros.dso", ROOMS_OF_DSO) != []  # fmt: skip
    with pytest.raises(AssertionError, match="which layer attic is"):
        upward_imports("ceiling_dso_ros.attic.old", set(), PACKAGE, LAYERS)
