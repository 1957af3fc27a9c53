"""What becomes of kernels where numba cannot do what it is asked for."""

import numba
import pytest

from ceiling_dso_ros.dso import jit


def double(x):
    return 2 * x


def test_without_a_cache_folder_kernels_still_work(monkeypatch):
    njit = numba.njit

    def without_folder(**options):
        if options["cache"]:
            raise RuntimeError("cannot cache function 'double': no locator available")
        return njit(**options)

    monkeypatch.setattr(numba, "njit", without_folder)
    with pytest.warns(UserWarning, match="NUMBA_CACHE_DIR"):
        compiled = jit.kernel(double)
    assert compiled(3) == 6


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
