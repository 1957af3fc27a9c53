# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.experiments.sweep.plan import by_sequence, parse_grid, read_plan
from ceiling_dso_ros.io.errors import InputError

PLAN = """
inputs: {square: [a.bag, b.bag], loops: [c.bag]}
grid: {fps: [3, 7.5], no_exposure: [true, false]}
set: {window.active_points: 2000}
seeds: 3
references: {a.bag: laser.tum}
baseline: {no_exposure: false}
"""


def test_a_plan_of_a_file(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN)
    plan = read_plan(path)
    bags = [str(tmp_path / f"{name}.bag") for name in "abc"]
    assert plan.inputs == {"square": bags[:2], "loops": bags[2:]}
    assert plan.grid == {"fps": ["3", "7.5"], "no_exposure": ["true", "false"]}
    assert plan.constant == {"window.active_points": "2000"}
    assert plan.references == {str(tmp_path / "a.bag"): str(tmp_path / "laser.tum")}
    assert (plan.seeds, plan.baseline) == (3, {"no_exposure": "false"})
    path.write_bytes(plan.as_yaml())
    assert read_plan(path) == plan


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grids: {}", "grids is unknown; did you mean grid"),
        ("inputs: []", "there is no recording"),
        ("inputs: [a]\nseeds: 0", "seeds 0: at least 1"),
        ("inputs: [a]\nseeds: many", "a whole number"),
        ("inputs: [a]\ngrid: {fps: []}", "there are no values"),
        ("inputs: [a]\ngrid: {fps: [3, 3]}", "a value is there twice"),
        ("inputs: [a]\ngrid: {fps: [3]}\nset: {fps: 6}", "in the grid and set for all runs"),
        ("inputs: [a]\nbaseline: {fps: 3}", "is not in the grid"),
        ("- a", "expected the names"),
    ],
)
def test_what_is_no_plan(tmp_path, text, message):
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_plan(path)


def test_values_of_a_dimension():
    assert parse_grid("size=848x480,424x240") == ("size", ["848x480", "424x240"])
    assert parse_grid("a=[1,2],[3,4]") == ("a", ["[1,2]", "[3,4]"])
    for text in ("size", "=3", "size=", "size=a,,b"):
        with pytest.raises(InputError, match="expected key=value"):
            parse_grid(text)


def test_recordings_of_one_name_are_two_sequences():
    assert by_sequence(["a/x.bag", "b/x.bag", "c/x.bag", "a/x.bag"]) == {
        "x": ["a/x.bag"], "x#2": ["b/x.bag"], "x#3": ["c/x.bag"],
    }  # fmt: skip
