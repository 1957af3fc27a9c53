# SPDX-License-Identifier: BSD-3-Clause
import signal
import threading

import pytest

from ceiling_dso_ros.io.interrupts import deferred_interrupt, was_interrupt


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_comes_after_the_block(interruptible, number):
    steps = []
    before = signal.signal(number, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), deferred_interrupt():
            signal.raise_signal(number)
            steps.append("finished")
    finally:
        signal.signal(number, before)
    assert steps == ["finished"]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_without_an_interrupt_nothing_happens():
    handler = signal.getsignal(signal.SIGINT)
    with deferred_interrupt():
        pass
    assert signal.getsignal(signal.SIGINT) is handler


def test_in_another_thread():
    finished = []

    def work():
        with deferred_interrupt():
            finished.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert finished


def test_what_compiled_code_makes_of_an_interrupt_is_one():
    wrapped = SystemError("returned a result with an exception set")
    wrapped.__cause__ = KeyboardInterrupt()
    assert was_interrupt(wrapped)
    assert was_interrupt(KeyboardInterrupt())
    assert not was_interrupt(SystemError("of another kind"))
