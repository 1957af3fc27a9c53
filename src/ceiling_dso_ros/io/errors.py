# SPDX-License-Identifier: BSD-3-Clause
"""Errors of files and frames. Every message is one line: where, what is wrong, and what to do."""

LONGEST_MESSAGE = 2000  # characters: a message may quote what a file contains


def one_line(text: str) -> str:
    """A text as one line of bounded length that a terminal or a log can show, whatever it quotes."""
    shown = "".join(character if character.isprintable() else " " for character in text[: LONGEST_MESSAGE + 1])
    return shown if len(shown) <= LONGEST_MESSAGE else f"{shown[: LONGEST_MESSAGE - 3]}..."


class _OneLineError(Exception):
    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class InputError(_OneLineError):
    """An input that cannot be used at all; the message names the file, what is wrong with it and what to do."""


class FrameError(_OneLineError):
    """One image that cannot be used; the frame is skipped and the run goes on."""


class OutputError(OSError):
    """Files that cannot be written.

    Attributes:
        lines: one for each file, which names it and says why.
    """

    def __init__(self, *lines: str) -> None:
        super().__init__("; ".join(lines))
        self.lines = lines


def reason_of(error: OSError) -> str:
    """Why the system refused something, in words; errors that did not come from the system have no `strerror`."""
    return error.strerror or str(error) or type(error).__name__
