# SPDX-License-Identifier: BSD-3-Clause
import threading
import time

import numpy as np
import pytest

from ceiling_dso_ros.ros.mailbox import LATE_S, Mailbox


def test_messages_that_come_at_once_are_passed_on_in_their_order():
    mailbox = Mailbox()
    assert [mailbox.put(number) for number in range(14)] == [0] * 14
    assert [mailbox.take() for _ in range(14)] == list(range(14))


def test_the_oldest_are_left_out_when_the_work_takes_too_long(monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    mailbox, taken, dropped = Mailbox(), [], 0
    for number in range(200):  # one comes every 0.03 s, and each takes 0.05 s
        dropped += mailbox.put(number)
        if now_s[0] >= 0.05 * len(taken):
            taken.append(mailbox.take())
        now_s[0] += 0.03
    assert dropped == pytest.approx(200 - len(taken), abs=5)
    assert taken == sorted(taken)
    late = [int(now / 0.03) - number for now, number in zip(np.arange(len(taken)) * 0.05, taken)]
    assert max(late) * 0.03 < LATE_S + 0.06
    assert max(np.diff(taken)) <= 3  # no long gaps


def test_waiting_ends_when_a_message_comes():
    mailbox = Mailbox()
    thread = threading.Timer(0.05, mailbox.put, ["a message"])
    thread.start()
    assert mailbox.take() == "a message"
    thread.join()


def test_waiting_ends_when_it_is_closed():
    mailbox = Mailbox()
    thread = threading.Timer(0.05, mailbox.close)
    thread.start()
    assert mailbox.take() is None
    thread.join()


def test_what_has_not_been_taken_before_the_end_is_left():
    mailbox = Mailbox()
    mailbox.put("a message")
    mailbox.close()
    assert mailbox.take() is None
