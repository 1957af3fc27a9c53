# SPDX-License-Identifier: BSD-3-Clause
import threading

from ceiling_dso_ros.ros.mailbox import Mailbox


def test_newest_message_wins_and_the_replaced_ones_are_told():
    mailbox = Mailbox()
    assert [mailbox.put(number) for number in range(3)] == [False, True, True]
    assert mailbox.take(0.0) == 2
    assert mailbox.put(3) is False


def test_empty_mailbox_gives_none():
    mailbox = Mailbox()
    assert mailbox.take(0.0) is None
    mailbox.put("a message")
    mailbox.take(0.0)
    assert mailbox.take(0.0) is None


def test_waiting_ends_when_a_message_comes():
    mailbox = Mailbox()
    thread = threading.Timer(0.05, mailbox.put, ["a message"])
    thread.start()
    assert mailbox.take(60.0) == "a message"
    thread.join()
