# SPDX-License-Identifier: BSD-3-Clause
import threading

from ceiling_dso_ros.ros.mailbox import Mailbox


def test_newest_message_wins_and_the_replaced_ones_are_told():
    mailbox = Mailbox()
    assert [mailbox.put(number) for number in range(3)] == [False, True, True]
    assert mailbox.take() == 2
    assert mailbox.put(3) is False
    assert mailbox.take() == 3


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
