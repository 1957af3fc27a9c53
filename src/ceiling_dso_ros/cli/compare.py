# SPDX-License-Identifier: BSD-3-Clause
"""`compare`: two studies, with a verdict."""

import argparse
import sys
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "compare",
        help="compare two studies of `sweep`",
        description="Compare the runs of two studies that have the same sequence, settings and seed, such as those of "
        "two versions. Exit code 1 if the second one is worse beyond the spread.",
    )
    parser.add_argument("before", metavar="BEFORE", type=Path, help="folder of `sweep --out`")
    parser.add_argument("after", metavar="AFTER", type=Path, help="folder of another")
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Print the comparison.

    Raises:
        InputError: a folder has no study, or the two have nothing in common.
        SystemExit: with code 1 if the second study is worse.
    """
    from ceiling_dso_ros.experiments.report.comparison import compare
    from ceiling_dso_ros.experiments.report.study import read_study

    comparison = compare(read_study(options.before), read_study(options.after))
    print(comparison)
    if comparison.is_worse:
        sys.exit(1)
