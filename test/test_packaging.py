# SPDX-License-Identifier: BSD-3-Clause
"""The sdist and the wheel: what is in them, and that an installed wheel works from any folder."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
import setuptools

ROOT = Path(__file__).parents[1]
VERSION = ElementTree.parse(ROOT / "package.xml").findtext("version")
BUILT = ("__pycache__", "*.egg-info", "build", "devel", "install", "out", ".*")  # not part of the sources
PYTHON38 = ROOT / ".venv38" / "bin" / "python"

pytestmark = pytest.mark.skipif(
    tuple(map(int, setuptools.__version__.split(".")[:2])) < (66, 1) or importlib.util.find_spec("wheel") is None,
    reason="needs setuptools from 66.1 on and wheel, as pip fetches them for a build",
)


def run(*words, **options):
    """What a process that succeeds has printed."""
    result = subprocess.run(list(map(str, words)), capture_output=True, text=True, **options)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Of a process that knows no checkout, with a home folder of its own."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}
    return {**kept, "HOME": str(tmp_path_factory.mktemp("home"))}


@pytest.fixture(scope="module")
def distributions(environment, tmp_path_factory):
    """(sdist, the wheel built of it), without a network."""
    folder = tmp_path_factory.mktemp("distributions")
    shutil.copytree(ROOT, folder / "copy", ignore=shutil.ignore_patterns(*BUILT))
    build = "import sys; from setuptools import build_meta; getattr(build_meta, sys.argv[1])(sys.argv[2])"
    run(sys.executable, "-c", build, "build_sdist", folder, cwd=folder / "copy", env=environment)
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder)
    unpacked = folder / f"ceiling_dso_ros-{VERSION}"
    run(sys.executable, "-c", build, "build_wheel", folder, cwd=unpacked, env=environment)
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel


@pytest.fixture(scope="module")
def install(distributions, environment, tmp_path_factory):
    """Gives the folder of commands of a new environment of a Python: the wheel, and the libraries of that Python's."""

    def make(python):
        target = tmp_path_factory.mktemp("installed")
        run(python, "-m", "venv", "--without-pip", target, env=environment)
        where = "import sysconfig; print(sysconfig.get_paths()['purelib'])"
        own = Path(run(target / "bin" / "python", "-c", where, env=environment).strip())
        libraries = run(python, "-c", "import site; print(*site.getsitepackages(), sep='\\n')", env=environment)
        (own / "libraries.pth").write_text(libraries)
        pip = (sys.executable, "-m", "pip", "--python", target / "bin" / "python")
        run(*pip, "install", "--no-deps", "--no-index", "--quiet", distributions[1], env=environment)
        return target / "bin"

    return make


def test_wheel_holds_all_of_src_and_nothing_else(distributions):
    source = ROOT / "src"
    files = {path.relative_to(source).as_posix() for path in source.rglob("*") if path.is_file()}
    files = {name for name in files if not re.search(r"__pycache__/|\.egg-info/", name)}
    with zipfile.ZipFile(distributions[1]) as wheel:
        packed = {name for name in wheel.namelist() if ".dist-info/" not in name}
        metadata = wheel.read(f"ceiling_dso_ros-{VERSION}.dist-info/METADATA").decode()
    assert packed == files
    required = re.findall(r"^Requires-Dist: ([\w-]+) ?\(?==([^\s)]+)\)?$", metadata, re.MULTILINE)
    pins = re.findall(r"^([\w-]+)==(\S+)$", (ROOT / "requirements.txt").read_text(), re.MULTILINE)
    assert sorted(required) == sorted(pins)
    assert len(pins) > 5


def test_sdist_holds_no_tests(distributions):
    with tarfile.open(distributions[0]) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}
    assert {"package.xml", "requirements.txt", "LICENSE", "README.md", "pyproject.toml"} <= names
    assert not [name for name in names if name.startswith("test")]


@pytest.mark.parametrize("python", [Path(sys.executable), PYTHON38], ids=["this Python", "Python 3.8"])
def test_installed_command_answers(python, install, environment, tmp_path):
    if not python.exists():
        pytest.skip("no .venv38: scripts/test makes it where it finds python3.8")
    commands = install(python)
    here = {"cwd": tmp_path, "env": environment}
    assert run(commands / "ceiling-dso", "--version", **here) == f"{VERSION}\n"
    assert run(commands / "ceiling-dso", "--help", **here).startswith("usage: ceiling-dso ")
    module = run(commands / "python", "-m", "ceiling_dso_ros", "--help", **here)
    assert module.startswith("usage: python3 -m ceiling_dso_ros ")


@pytest.mark.long
def test_installed_command_tracks_a_recording(install, environment, tmp_path):
    commands = install(sys.executable)
    here = {"cwd": tmp_path, "env": environment}
    drive = ("--duration", 5, "--size", "424x240", "--fps", 15, "--out", "drive.bag")
    run(commands / "ceiling-dso", "simulate", "loops", *drive, **here)
    said = run(commands / "ceiling-dso", "run", "drive.bag", "--robot", "drive.robot.yaml", "--out", "out", **here)
    tracked, frames = map(int, re.match(r"(\d+) of (\d+) frames tracked", said).groups())
    assert frames > 70
    assert tracked > 0.4 * frames  # the robot stands for the first two seconds
    assert len((tmp_path / "out" / "fused.tum").read_text().splitlines()) > 50
    # Kernels are kept beside the package, where it may be written: nothing is compiled a second time.
    assert list(commands.parent.rglob("kernels.py*.*"))
    assert not list(Path(environment["HOME"]).rglob("*.nbi"))
