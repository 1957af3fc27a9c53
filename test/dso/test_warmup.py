# SPDX-License-Identifier: BSD-3-Clause
"""The warm-up reaches every kernel, or says that it did not; what is cached is complete and of today's sources."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ceiling_dso_ros.dso import warmup
from ceiling_dso_ros.dso.compute import kernel_cache
from ceiling_dso_ros.dso.compute.kernel_cache import python_tag


def test_it_makes_enough_keyframes():
    assert warmup.warm_up() == warmup.KEYFRAMES


@pytest.mark.long
def test_a_noisy_camera_on_a_vehicle_compiles_nothing_more():
    """In a process of its own: what other tests have compiled does not count."""
    script = """
from ceiling_dso_ros.dso import warmup
from ceiling_dso_ros.dso.adjustment.planar_motion import add_planar_motion
from ceiling_dso_ros.dso.images.noise import cell_noise, smooth_image
assert warmup.warm_up() == warmup.KEYFRAMES
print([len(kernel.signatures) for kernel in (add_planar_motion, cell_noise, smooth_image)])
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    words = [sys.executable, "-c", script]
    result = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[1, 1, 1]"


def test_it_says_when_it_did_not(monkeypatch, capsys):
    monkeypatch.setattr(warmup, "warm_up", lambda: 1)
    monkeypatch.setattr(warmup, "_marker", lambda: None)
    assert warmup.main() == 1
    assert "some kernels are not compiled" in capsys.readouterr().err


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache folder in which nothing is complete, and kernels that are loaded at once."""
    monkeypatch.setattr(warmup, "_marker", lambda: tmp_path / f"kernels.{python_tag()}.today")
    monkeypatch.setattr(warmup, "warm_up", lambda: warmup.KEYFRAMES)
    monkeypatch.setattr(warmup, "cache_folders", lambda: {tmp_path / "room"})
    (tmp_path / "room").mkdir()
    return tmp_path


def test_what_is_outdated_is_removed_and_what_is_complete_stays(cache):
    ours = [f"a.f-1.{python_tag()}.{end}" for end in ("nbi", "1.nbc")]
    for name in (*ours, f"kernels.{python_tag()}.yesterday", "a.f-1.py27.nbi", "a.pyc"):
        (cache / name).touch()
    (cache / "room" / ours[1]).touch()
    assert warmup.main() == 0
    assert not list((cache / "room").iterdir())
    left = {"room", f"kernels.{python_tag()}.today", "a.f-1.py27.nbi", "a.pyc"}
    assert {path.name for path in cache.iterdir()} == left
    (cache / ours[0]).touch()
    assert warmup.main() == 0
    assert (cache / ours[0]).exists()


def test_missing_kernels_are_compiled_by_another_process(cache, monkeypatch):
    commands, told = [], []
    monkeypatch.setattr(kernel_cache.subprocess, "run", lambda command, **_: commands.append(command))
    warmup.load_kernels(told.append)
    assert commands[0][-1] == "ceiling_dso_ros.dso.warmup"
    assert "compiling" in told[0]
    assert warmup.main() == 0
    warmup.load_kernels(told.append)
    assert len(commands) == len(told) == 1


def test_the_marker_depends_on_the_sources(monkeypatch, tmp_path):
    before = warmup._marker()
    assert before == warmup._marker()
    (tmp_path / "warmup.py").write_text("changed")
    monkeypatch.setattr(warmup, "__file__", str(tmp_path / "warmup.py"))
    assert warmup._marker().parent == before.parent
    assert warmup._marker() != before


def test_the_process_that_compiles_ends_with_the_one_that_waits_for_it(tmp_path):
    """Nobody else would end it, and who starts next compiles as well."""
    (tmp_path / "endless.py").write_text(
        """
import time
from ceiling_dso_ros.dso.compute.kernel_cache import fill_cache
open("began", "w").close()
fill_cache(None, set(), lambda: time.sleep(60.0))
"""
    )
    script = """
from pathlib import Path
from ceiling_dso_ros.dso.compute.kernel_cache import compile_if_missing
compile_if_missing(Path("never"), "endless", print)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *(path for path in sys.path if path)])}
    waiting = subprocess.Popen([sys.executable, "-c", script], env=environment, cwd=tmp_path)
    children = Path(f"/proc/{waiting.pid}/task/{waiting.pid}/children")
    while not (tmp_path / "began").exists():
        assert waiting.poll() is None
        time.sleep(0.01)
    (compiling,) = children.read_text().split()
    waiting.kill()
    waiting.wait()
    deadline_s = time.monotonic() + 50.0  # without its end it would sleep for longer
    while Path(f"/proc/{compiling}").exists() and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert time.monotonic() < deadline_s
