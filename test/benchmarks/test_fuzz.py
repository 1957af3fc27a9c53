# SPDX-License-Identifier: BSD-3-Clause
"""A small part of `scripts/bench fuzz`, always with the same inputs; and that it finds what it is made for."""

import re
import time

import numpy as np
import pytest
from support.fuzzing import bags, commands, files, maps, runner
from support.fuzzing.rules import USED, BrokenRuleError, outcome_of, require_clear_line, require_finite
from support.fuzzing.runner import Target, run

from ceiling_dso_ros.io.errors import InputError

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")  # which users would read beside the clear line

INPUTS = 15  # of each target; the first of a full run


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    return [*files.targets(folder), *maps.targets(folder), *bags.targets(folder), *commands.targets(folder)]


@pytest.mark.long
def test_wrong_files_and_commands_break_no_rule(targets):
    outcomes = [run(target, 0, 4 if target.name in ("run", "calibrate") else INPUTS) for target in targets]
    assert [(each.name, failure.shown, failure.why) for each in outcomes for failure in each.failures] == []
    assert sum(each.inputs for each in outcomes) > 300
    assert 0 < sum(each.used for each in outcomes) < sum(each.inputs for each in outcomes)


def test_a_full_run_has_enough_inputs(targets):
    assert sum(target.count for target in targets) > 12_000


def of_numbers(use, has_state=False):
    """A target whose inputs are numbers from 0 to 999."""

    def make(random):
        number = random.randrange(1000)
        return number, lambda: outcome_of(lambda: use(number))

    return Target("numbers", 100, lambda: make, has_state)


def refuse(number):
    if number % 2:
        raise InputError(f"{number} is odd")
    return number


def test_what_is_used_and_what_is_refused_is_counted():
    outcome = run(of_numbers(refuse), 0, 100)
    assert outcome.inputs == 100
    assert 10 < outcome.used < 90
    assert outcome.failures == []


def not_finite(number):
    return {"poses": [np.full(3, np.nan if number > 100 else 0.0)]}


def another_error(number):
    return 1 // (number <= 100)


def two_lines(number):
    error = InputError("a")
    error.args = ("a\nb" if number > 100 else "a",)
    raise error


def hangs(number):
    while number > 100:
        time.sleep(0.01)


def grows(number):
    return len(np.ones((60_000_000 if number > 100 else 1, 8), np.uint8))


BROKEN = [
    (not_finite, "has numbers that are not finite"),
    (another_error, "ZeroDivisionError"),
    (two_lines, "not one line"),
    (hangs, "takes more than 0.1 s"),
]


@pytest.mark.parametrize(
    ("use", "why", "has_state"),
    [
        *((use, why, has_state) for use, why in BROKEN for has_state in (False, True)),
        (grows, r"takes 4\d\d MB|takes 5\d\d MB", True),  # made smaller, it would take that memory again and again
    ],
)
def test_each_rule_is_checked(monkeypatch, use, why, has_state):
    if use is hangs:
        monkeypatch.setattr(runner, "DEADLINE_S", 0.1)
    outcome = run(of_numbers(use, has_state), 0, 30)
    (failure,) = outcome.failures[:1]
    assert int(failure.shown) > 100
    if use in (not_finite, another_error) and not has_state:
        assert failure.shown == "101"  # as small as possible
    assert re.search(why, failure.why)


def test_a_failure_comes_again_with_its_seed():
    first = run(of_numbers(another_error, has_state=True), 7, 30).failures[0]
    again = run(of_numbers(another_error, has_state=True), first.seed, 30).failures[0]
    assert (again.seed, again.shown) == (first.seed, first.shown)


@pytest.mark.parametrize(
    "text", ["", "a\nb", "\x1b[31m", "x" * 3000, "MemoryError: ", "'NoneType' object has no attribute 'x'"]
)
def test_lines_that_are_not_clear(text):
    with pytest.raises(BrokenRuleError):
        require_clear_line(text)


def test_unknown_numbers_are_named():
    require_finite({"a": [1.0, np.zeros(2), "text", None]})
    assert outcome_of(lambda: (1, 2.0)) == USED
    with pytest.raises(BrokenRuleError, match=r"the result\['a'\] is inf"):
        require_finite({"a": np.float64("inf")})
