# SPDX-License-Identifier: BSD-3-Clause
"""Servers without a master, to which wrong messages come between good ones."""

import sys
from io import BytesIO
from random import Random
from typing import Any, Callable, List

import pytest
from support.checkout import CHECKOUT
from support.fuzzing.messages import mutated_message, serialised
from support.fuzzing.rules import REFUSED, USED, BrokenRuleError, require_clear_line, require_finite

from ceiling_dso_ros.io.ros_messages import TYPES

sys.path.insert(0, str(CHECKOUT / "test" / "ros"))

from rosless import Rosless

UNKNOWN = ("rmse", "scale", "sigma")  # fields in which NaN means that there is none
GO_ON = 60  # good messages after which there must be output again: more than a second

Message = Any  # ROS has no types


def wrong(random: Random, message: Message) -> Message:
    """A message as another node may send it instead."""
    buffer = BytesIO()
    message.serialize(buffer)
    known = TYPES.deserialize_ros1(buffer.getvalue(), message._type.replace("/", "/msg/"))
    changed = type(message)().deserialize(serialised(mutated_message(random, known)))
    changed._connection_header = {"callerid": "/other"}
    return changed


class World(Rosless):  # type: ignore[misc]  # of the tests, which are not checked
    """Stands for the master; what is published must be finite."""

    def publish(self, topic: str, message: Message) -> None:
        """See Rosless."""
        super().publish(topic, message)
        require_finite(message, topic, UNKNOWN)
        message.serialize(BytesIO())

    def require_clear_log(self) -> None:
        """Nothing that was logged, or is said in the diagnostics, tells of an error of Python."""
        logged: List[str] = list(self.logged)
        self.logged.clear()
        for line in logged:
            require_clear_line(line)
        report = self.diagnostics()
        for text in (report.message, *(each.value for each in report.values)):
            if text:
                require_clear_line(text)


class Node:
    """A server that good and wrong messages come to; the messages of a subclass are those of a drive straight on."""

    def __init__(self, patch: pytest.MonkeyPatch, **private: object) -> None:
        self.world = World(patch, **private)
        self.index = 0

    def good(self) -> None:
        """Send the next good message."""
        raise NotImplementedError

    @property
    def outputs(self) -> int:
        """How many there were."""
        raise NotImplementedError

    def use(self, act: Callable[[], object]) -> str:
        """Do something wrong, and then hear good messages until there is output again."""
        rejected = self.rejected
        act()
        before = self.outputs
        for _ in range(GO_ON):
            self.good()
            if self.outputs > before:
                break
        else:
            raise BrokenRuleError(f"no output after {GO_ON} good messages")
        self.world.require_clear_log()
        return USED if self.rejected == rejected else REFUSED

    @property
    def rejected(self) -> int:
        """How many messages were not used."""
        raise NotImplementedError

    def hear(self, topic: str, message: Message) -> str:
        """Hear a wrong message."""
        return self.use(lambda: self.world.callbacks[topic](message))
