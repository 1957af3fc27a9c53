# SPDX-License-Identifier: BSD-3-Clause
"""Which nodes send on a topic that one node alone should send on."""

from typing import Any, List


class Senders:
    """Notices that two nodes send in turn, such as a base and a publisher of its model with wheels that never turn.

    A node that takes over from another, as after a restart, is nothing to complain of.
    """

    def __init__(self) -> None:
        self._heard: List[str] = []  # the nodes in the order in which each was heard first

    def complaint(self, message: Any) -> str:  # noqa: ANN401 any message of rospy
        """That a message comes from a node that another one had taken over from, in words; empty where it does not."""
        header = getattr(message, "_connection_header", None) or {}  # rospy sets it when it has received one
        sender = header.get("callerid", "")
        if self._heard[-1:] == [sender]:
            return ""
        if sender not in self._heard:
            self._heard.append(sender)
            return ""
        both = f"{self._heard[-1]} and {sender}"
        self._heard = [sender]
        return f"{both} send them in turn: switch one off, or give it another topic"
