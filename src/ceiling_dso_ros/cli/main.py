# SPDX-License-Identifier: BSD-3-Clause
"""The commands of `ceiling-dso`, which is `python3 -m ceiling_dso_ros` too, and their exit codes."""

import argparse
import signal
import sys
from pathlib import Path
from typing import NoReturn, Optional, Sequence

from ceiling_dso_ros import __version__
from ceiling_dso_ros.cli import (
    benchmark,
    calibrate,
    collect,
    compare,
    evaluate,
    mapping,
    record,
    reference,
    run,
    simulate,
    sweep,
)
from ceiling_dso_ros.cli.outputs import complain
from ceiling_dso_ros.cli.standard_streams import forgive_standard_streams
from ceiling_dso_ros.io.errors import InputError, OutputError, one_line
from ceiling_dso_ros.io.interrupts import INTERRUPTS, was_interrupt

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130

PROGRAM = "ceiling-dso"  # as pip installs it
COMMANDS = (run, evaluate, sweep, compare, mapping, reference, collect, calibrate, simulate, benchmark, record)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like all errors of the package."""

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_INPUT, one_line(f"error: {message}; see {self.prog} --help") + "\n")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run a command.

    Args:
        arguments: the words after the program's name; those of the process when None.

    Returns:
        The exit code: 0 done, 1 failed while running, 2 wrong usage, unreadable input or no place for the output, 130
        interrupted. All but 0 come with one line on stderr, or one for each file that could not be written.
    """
    installed = Path(sys.argv[0]).name == PROGRAM
    parser = _Parser(
        prog=PROGRAM if installed else "python3 -m ceiling_dso_ros",
        description="Ceiling visual odometry on recordings.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_parser(commands)
    options = parser.parse_args(arguments)
    try:
        for name, value in vars(options).items():
            if isinstance(value, Path):  # a shell leaves the ~ of --out=~/drive as it is
                setattr(options, name, value.expanduser())
        options.execute(options)
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)
    except InputError as error:
        return _complain(str(error), WRONG_INPUT)
    except OutputError as error:
        for line in error.lines:
            complain(line)
        return FAILED
    except Exception as error:  # any other error: one line instead of a traceback
        if was_interrupt(error):
            return _complain("interrupted", INTERRUPTED)
        if sys.flags.dev_mode:
            raise
        return _complain(f"{type(error).__name__}: {error}; python3 -X dev -m ceiling_dso_ros shows where", FAILED)
    return DONE


def run_process() -> NoReturn:
    """Run the command that this process was started with: the entry point of `ceiling-dso`.

    SIGTERM ends it like Ctrl-C. Ctrl-C ends it also if a shell's `&` has disabled it. A reader of the output, such as
    `head`, may close it at any time.
    """
    for number in INTERRUPTS:
        signal.signal(number, signal.default_int_handler)
    output = forgive_standard_streams()
    try:
        code = main()
    except SystemExit as end:  # of the parser, after --help or for wrong usage
        code = int(end.code or DONE)
    output.flush()
    if output.error is not None and not isinstance(output.error, BrokenPipeError) and code == DONE:
        code = _complain(f"cannot write the standard output: {output.error.strerror}", FAILED)
    sys.exit(code)


def _complain(message: str, code: int) -> int:
    complain(message)
    return code
