# SPDX-License-Identifier: BSD-3-Clause
import threading

import pytest

from ceiling_dso_ros.dso.compute.schedulers import LiveScheduler, SequentialScheduler


@pytest.fixture(params=[SequentialScheduler, LiveScheduler])
def scheduler(request):
    scheduler = request.param()
    yield scheduler
    scheduler.close()


def fail():
    raise ValueError("no solution")


def test_results_come_once_and_in_order(scheduler):
    for number in range(5):
        scheduler.submit(lambda number=number: number)
    scheduler.wait()
    assert scheduler.backlog == 0
    assert scheduler.take_results() == [0, 1, 2, 3, 4]
    assert scheduler.take_results() == []


def test_what_a_task_raises_comes_with_the_results_and_the_next_task_is_done(scheduler):
    scheduler.submit(fail)
    scheduler.submit(lambda: "after")
    scheduler.wait()
    with pytest.raises(ValueError, match="no solution"):
        scheduler.take_results()
    assert scheduler.take_results() == ["after"]


def test_discarded_tasks_leave_nothing(scheduler):
    scheduler.submit(fail)
    scheduler.discard()
    assert scheduler.take_results() == []


def test_sequential_tasks_are_done_where_they_are_given():
    scheduler = SequentialScheduler()
    scheduler.submit(threading.get_ident)
    assert scheduler.take_results() == [threading.get_ident()]


def test_live_tasks_do_not_hold_up_who_gives_them():
    scheduler, go_on = LiveScheduler(), threading.Event()
    scheduler.submit(go_on.wait)
    scheduler.submit(threading.get_ident)
    assert scheduler.backlog == 2
    assert scheduler.take_results() == []
    go_on.set()
    scheduler.wait()
    done, thread = scheduler.take_results()
    assert done
    assert thread != threading.get_ident()
    scheduler.close()
