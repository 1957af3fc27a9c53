# SPDX-License-Identifier: BSD-3-Clause
"""What becomes of kernels where numba cannot do what it is asked for."""

import os
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numba
import pytest

from ceiling_dso_ros.dso.compute import jit


def double(x):
    return 2 * x


def test_without_a_cache_folder_kernels_still_work(monkeypatch):
    njit = numba.njit

    def without_folder(*function, **options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function 'double': no locator available")
        return njit(*function, **options)

    monkeypatch.setattr(jit, "_uncached", [])
    assert jit.cache_problem() == ""
    monkeypatch.setattr(numba, "njit", without_folder)
    assert jit.kernel(double)(3) == 6
    assert f"{Path(__file__).parent}/__pycache__" in jit.cache_problem()
    assert "set NUMBA_CACHE_DIR to a folder" in jit.cache_problem()
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/full")
    assert "/full, " in jit.cache_problem()


def test_a_cache_folder_that_others_can_write_is_not_used(monkeypatch, tmp_path):
    """Numba unpickles what it finds there, which may run anything."""
    monkeypatch.setattr(jit, "_distrusted", [])
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    compiled = jit.kernel(double)
    folder = jit.cache_folder(compiled)
    assert folder is not None
    assert folder.is_relative_to(tmp_path) if hasattr(folder, "is_relative_to") else str(tmp_path) in str(folder)
    assert jit.cache_problem() == ""
    folder.chmod(0o777)
    compiled = jit.kernel(double)
    assert jit.cache_folder(compiled) is None
    assert compiled(3) == 6
    assert list(folder.iterdir()) == []
    assert f"{folder} is not used, because another user could have put machine code there" in jit.cache_problem()
    assert jit.cache_problem().isprintable()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
@pytest.mark.parametrize(("of_folder", "of_source", "trusted"), [(4321, 0, False), (4321, 4321, True), (0, 4321, True)])
def test_a_cache_folder_of_another_user_is_not_used(tmp_path, of_folder, of_source, trusted):
    """But for one of the user whose sources are run anyway, as in a container that mounts a checkout."""
    folder, source = tmp_path / "cache", tmp_path / "kernels.py"
    folder.mkdir()
    source.touch()
    os.chown(folder, of_folder, -1)
    os.chown(source, of_source, -1)
    assert jit.is_trusted(folder, source) is trusted


@pytest.mark.parametrize(
    ("features", "expected"),
    [
        ("+avx2,+fma", "+avx2,+fma,+fast-gather"),
        ("+avx2,-avx512f", "+avx2,-avx512f,+fast-gather"),
        ("+avx2,+avx512f", "+avx2,+avx512f"),
        ("+sse2", "+sse2"),
        ("+avx2,-fast-gather", "+avx2,-fast-gather"),
    ],
)
def test_gathers_are_asked_for_where_only_avx2_is(monkeypatch, features, expected):
    monkeypatch.setattr(numba.config, "CPU_FEATURES", features)
    jit._let_avx2_gather()
    assert expected == numba.config.CPU_FEATURES


GATHERS = """
import numpy as np
from ceiling_dso_ros.dso.adjustment import residual_kernels
from ceiling_dso_ros.dso.mapping import activation_kernels
from ceiling_dso_ros.dso.tracking import tracking_kernels

n, f = 64, np.float32
points, sums = residual_kernels.LivePoints.of_capacity(n), residual_kernels.pixel_sums(n)
image, eye = np.zeros(100 * 100, f), np.eye(3, dtype=f)
residual_kernels.sum_pattern(image, 100, 100, eye, np.zeros(3, f), f(1), f(0), f(0), points, n, sums)
u = np.zeros(n, f)
tracking_kernels.accumulate(u, u, u, u, image, 100, 100, np.ones(4), np.eye(4), 1.0, 0.0, 0.0, 20.0, np.zeros((9, 9)))
activation_kernels.add_pixel(
    image, 100, 100, eye, np.zeros(3, f), f(1), f(0), f(0), f(0), u, u, u, u, u, activation_kernels.new_sums(n)
)
for kernel in (residual_kernels.sum_pattern, tracking_kernels.accumulate, activation_kernels.add_pixel):
    print(sum("vgather" in line for line in next(iter(kernel.inspect_asm().values())).splitlines()))
"""


@pytest.mark.long
@pytest.mark.skipif(not llvm.get_host_cpu_features().get("avx2"), reason="the processor has no gather instruction")
def test_loops_over_pixels_are_vectorised(tmp_path):
    """They are as long as all that they call is inlined: nothing else tells, but twice the time."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    output = subprocess.run(
        [sys.executable, "-c", GATHERS], env=environment, stdout=subprocess.PIPE, check=True, text=True
    ).stdout
    counts = [int(count) for count in output.split()]
    assert len(counts) == 3
    assert min(counts) >= 12
