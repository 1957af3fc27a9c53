# SPDX-License-Identifier: BSD-3-Clause
"""Warnings by kind: the first of each kind is told, the others are counted."""

import re
from typing import Callable, Dict, List, Optional, Tuple

NUMBERS = re.compile(r"\d+(\.\d+)?")


class CountedMessages:
    """Messages by kind; those that differ in nothing but numbers are of one kind."""

    def __init__(self) -> None:
        self._counts: Dict[str, int] = {}
        self._first: Dict[str, str] = {}

    def add(self, text: str, kind: Optional[str] = None) -> bool:
        """Count a message; True if it is the first of its kind.

        Args:
            text: one line.
            kind: what it has in common with others of its kind, apart from numbers; the text itself if None.
        """
        key = NUMBERS.sub("#", text if kind is None else kind)
        is_first = key not in self._first
        self._first.setdefault(key, text)
        self._counts[key] = self._counts.get(key, 0) + 1
        return is_first

    def __len__(self) -> int:
        """How many messages there were."""
        return sum(self._counts.values())

    def first_and_counts(self) -> List[Tuple[str, int]]:
        """The first message of each kind, and how many of the kind there were, in the order of their first."""
        return [(self._first[key], count) for key, count in self._counts.items()]

    def most_frequent(self) -> Tuple[str, int]:
        """The first message of the most frequent kind, and how many of the kind there were; ("", 0) without any."""
        return max(self.first_and_counts(), key=lambda each: each[1], default=("", 0))


class WarningLog:
    """The warnings of a run."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        """Begin; `tell` is given the lines for the user."""
        self._tell = tell
        self._messages = CountedMessages()

    def add(self, text: str, kind: Optional[str] = None) -> None:
        """Add a warning; see `CountedMessages.add`."""
        if self._messages.add(text, kind):
            self._tell(text)

    def end(self) -> None:
        """Tell how many more there were of each kind."""
        for text, count in self._messages.first_and_counts():
            if count > 1:
                self._tell(f"{_and_more(count)}, the first was: {text}")

    @property
    def lines(self) -> List[str]:
        """One line for each kind: the first warning, and how many more there were."""
        return [
            text if count == 1 else f"{text} {_and_more(count)}" for text, count in self._messages.first_and_counts()
        ]


def ignore_warning(_text: str) -> None:
    """For those who do not want to be told."""


def _and_more(count: int) -> str:
    return f"... and {count - 1} more"
