# SPDX-License-Identifier: BSD-3-Clause
"""What a run may do to its process, and what is known of it afterwards."""

import os
from contextlib import closing

import pytest

from ceiling_dso_ros.experiments.sweep.supervision import Limits, SupervisedWorker

pytestmark = pytest.mark.usefixtures("acting")


@pytest.fixture
def run(spec_of, tmp_path):
    def carry_out(*sequences, limits=Limits(), timed=False):
        outcomes = []
        with closing(SupervisedWorker(limits)) as worker:
            for number, sequence in enumerate(sequences):
                folder = tmp_path / f"{number}"
                folder.mkdir()
                cores = sorted(os.sched_getaffinity(0))[:1]
                outcomes.append(worker.run(spec_of(sequence).as_json(), folder, timed, cores))
        return outcomes

    return carry_out


def test_a_run_that_ends(run):
    (outcome,) = run("drive")
    assert (outcome.status, outcome.message, outcome.numbers, outcome.tries) == ("done", "", {"frames": 3}, 1)


def test_what_is_wrong_with_one_run_does_not_stop_the_next(run):
    limits = Limits(time_s=2.0, memory_mb=300.0)
    hung, starved, crashed, failed, done = run("hang", "eat", "crash", "fail", "drive", limits=limits)
    assert hung.status == "hung"
    assert "about to hang" in hung.message
    assert starved.status == "starved"
    assert "about to eat" in starved.message
    assert crashed.status == "crashed"
    assert "signal 11" in crashed.message
    assert "about to crash" in crashed.message
    assert (failed.status, failed.message) == ("failed", "ValueError: what nobody expected")
    assert done.status == "done"


def test_a_process_that_is_killed_costs_one_try(run):
    (outcome,) = run("killed_once")
    assert (outcome.status, outcome.tries) == ("done", 2)


def test_a_timed_run_is_pinned(run):
    (outcome,) = run("cores", timed=True)
    assert outcome.numbers == {"frames": 1, "keyframes": 1}
