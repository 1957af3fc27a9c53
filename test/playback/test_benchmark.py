# SPDX-License-Identifier: BSD-3-Clause
"""What a benchmark adds up, what it writes, and what it compares with."""

import json
import time

import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.playback.benchmark import BenchmarkRun, describe, read_reference, summarize
from ceiling_dso_ros.playback.machine_speed import _workload, machine_ms


def run(scale=1.0, machine=(2.0, 4.0)):
    return BenchmarkRun(
        frames=10,
        tracked=8,
        lost=1,
        frame_ms={"all": 6.0 * scale, "keyframes": 30.0 * scale, "others": None},
        stage_ms={"keyframes": {"optimize": 20.0 * scale}, "others": {}},
        frame_rate_hz=30.0,
        machine_ms=machine,
    )


def test_medians_and_units():
    result = summarize([run(1.0), run(2.0), run(10.0)])
    assert result["frame_ms"] == {"all": 12.0, "keyframes": 60.0, "others": None}
    assert result["machine_ms"] == 3.0
    assert result["frame_units"] == {"all": 4.0, "keyframes": 20.0, "others": None}
    assert result["stage_ms"]["keyframes"]["optimize"] == 40.0
    assert result["speed_factor"] == pytest.approx(1 / (0.012 * 30))
    assert result["peak_memory_mb"] > 10
    json.dumps(result, allow_nan=False)


def test_comparison(tmp_path):
    result = summarize([run()])
    (tmp_path / "benchmark.json").write_text(json.dumps(result))
    assert read_reference(tmp_path) == result["frame_units"]
    text = describe(summarize([run(2.0)]), read_reference(tmp_path))
    assert "2.00" in next(line for line in text.splitlines() if line.startswith("keyframes"))
    assert "8 of 10 frames tracked" in text


def test_reference_of_another_implementation(tmp_path):
    content = {
        "frame_ms_over_machine_ms": 10.9,
        "keyframe_ms_over_machine_ms": 37.6,
        "other_frame_ms_over_machine_ms": 2.1,
    }
    (tmp_path / "reference.json").write_text(json.dumps(content))
    assert read_reference(tmp_path) == {"all": 10.9, "keyframes": 37.6, "others": 2.1}


@pytest.mark.parametrize("content", [None, "{", "{}", "[]"])
def test_nothing_to_compare_with(tmp_path, content):
    if content is not None:
        (tmp_path / "reference.json").write_text(content)
    with pytest.raises(InputError, match=str(tmp_path)):
        read_reference(tmp_path)


def test_the_unit_is_that_of_whole_runs():
    """The least of many cannot be more than the mean time of a run."""
    machine_ms(1)  # compiles
    start = time.perf_counter()
    least_ms = machine_ms(20)
    assert 0 < 20 * least_ms <= 1e3 * (time.perf_counter() - start)


def test_the_unit_s_workload():
    """The normal equations of an image that is a plane, whose bilinear samples are exact."""
    y, x = np.mgrid[:480, :848].astype(np.float32)
    ones = np.ones_like(x)
    xs, ys = (np.random.default_rng(0).uniform(1, 400, 50).astype(np.float32) for _ in range(2))
    residual = (xs + 2 * ys) - 100.0
    weight = np.minimum(1.0, 9.0 / np.abs(residual))
    expected = (weight * (1 + 2 + 4 + 3 * residual)).sum()
    assert _workload(x + 2 * y, ones, 2 * ones, xs, ys) == pytest.approx(expected, rel=1e-3)
