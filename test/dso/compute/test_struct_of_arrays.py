# SPDX-License-Identifier: BSD-3-Clause
"""Kernels take structs as they are, without typing their arrays anew."""

from typing import NamedTuple

import numba
import numpy as np
import pytest

from ceiling_dso_ros.dso.compute.struct_of_arrays import struct_of_arrays


@struct_of_arrays
class Inner(NamedTuple):
    x: np.ndarray
    y: np.ndarray


@struct_of_arrays
class Outer(NamedTuple):
    inner: Inner
    index: np.ndarray
    rows: np.ndarray
    weights: np.ndarray
    values: np.ndarray


def outer():
    rows = np.arange(6.0).reshape(2, 3)
    return Outer(Inner(np.ones(3), np.full(3, 2.0)), np.array([1]), rows, np.ones(3, np.float32), np.zeros(3))


@numba.njit
def fill(struct):
    total = 0.0
    for array in struct.inner:
        total += array.sum()
    struct.values[:] = struct.rows[struct.index[0]] * struct.weights
    return total


def test_a_kernel_reads_and_writes_the_fields():
    struct = outer()
    assert fill(struct) == 9.0
    np.testing.assert_array_equal(struct.values, [3.0, 4.0, 5.0])


def test_later_calls_are_not_typed_in_python(monkeypatch):
    fill(outer())
    monkeypatch.setattr(
        type(fill), "typeof_pyval", lambda self, value: pytest.fail(f"{type(value).__name__} is typed anew")
    )
    for size in range(1, 300):
        heap = bytearray(size)  # what is left in memory must not matter
        del heap
        fill(outer())


def test_arrays_that_a_kernel_would_misread_are_refused():
    struct = outer()
    with pytest.raises(TypeError, match=r"Inner\.x is not C-contiguous"):
        fill(struct._replace(inner=Inner(np.ones(6)[::2], np.ones(3))))
    with pytest.raises(TypeError, match=r"Outer\.rows is not C-contiguous"):
        fill(struct._replace(rows=struct.rows.T))
