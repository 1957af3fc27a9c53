# SPDX-License-Identifier: BSD-3-Clause
from ceiling_dso_ros.io.warning_log import CountedMessages, WarningLog


def test_the_first_of_each_kind_is_told_and_the_others_are_counted():
    told = []
    log = WarningLog(told.append)
    for number in range(1, 160):
        log.add(f"a.bag, message {number}: 100 bytes instead of {number}", f"100 bytes instead of {number}")
    log.add("a.bag, message 160: no stamp", "no stamp")
    assert told == ["a.bag, message 1: 100 bytes instead of 1", "a.bag, message 160: no stamp"]
    log.end()
    assert told[2:] == ["... and 158 more, the first was: a.bag, message 1: 100 bytes instead of 1"]
    assert log.lines == ["a.bag, message 1: 100 bytes instead of 1 ... and 158 more", "a.bag, message 160: no stamp"]


def test_without_a_kind_the_text_is_its_own():
    log = WarningLog([].append)
    for text in ("cropped to 10x20", "cropped to 10.5x20", "scaled"):
        log.add(text)
    assert log.lines == ["cropped to 10x20 ... and 1 more", "scaled"]


def test_the_most_frequent_message():
    messages = CountedMessages()
    assert messages.most_frequent() == ("", 0)
    for text in ("lost 1", "dark 1", "dark 2", "lost 2", "dark 3"):
        messages.add(text)
    assert messages.most_frequent() == ("dark 1", 3)
    assert len(messages) == 5
