# SPDX-License-Identifier: BSD-3-Clause
"""Gives wrong inputs to everything that reads one: files, recordings, settings, commands, and messages of the nodes.

Each is made of a valid one by changes of its bytes or its fields. Whatever is in it, there may be no error but one of
the package's own, with one clear line, no delay, no memory beyond bounds, and no output that is not finite.
"""

import argparse
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import List

from support.fuzzing import bags, commands, files, handlers, maps
from support.fuzzing.runner import Outcome, limit_addresses, run
from tabulate import tabulate


def report(outcomes: List[Outcome]) -> str:
    """One row for each target, and their sum."""
    rows = [
        [each.name, each.inputs, each.used, each.inputs - each.used, f"{1e3 * each.slowest_s:.0f}", len(each.failures)]
        for each in outcomes
    ]
    sums = [sum(values) for values in zip(*((row[1], row[2], row[3], row[5]) for row in rows))]
    rows.append(["all", *sums[:3], "", sums[3]])
    return tabulate(rows, headers=["target", "inputs", "used", "refused", "longest [ms]", "failures"])


def main() -> int:
    """Print the failures and a table; 1 if there is a failure."""
    parser = argparse.ArgumentParser(prog="scripts/bench fuzz", description=__doc__)
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="of the first batch; default %(default)s")
    parser.add_argument("--share", metavar="S", type=float, default=1.0, help="of the inputs of a full run; default 1")
    parser.add_argument(
        "--only", metavar="TARGET", nargs="+", default=[], help="targets whose names contain these words"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    outcomes: List[Outcome] = []
    with tempfile.TemporaryDirectory() as name, handlers.without_a_master(Path(name)) as nodes:
        folder = Path(name)
        targets = [
            *files.targets(folder),
            *maps.targets(folder),
            *bags.targets(folder),
            *nodes,
            *commands.targets(folder),
        ]
        limit_addresses()
        for target in targets:
            if options.only and not any(word in target.name for word in options.only):
                continue
            begin_s = time.perf_counter()
            outcomes.append(run(target, options.seed, max(1, round(options.share * target.count))))
            print(f"{target.name}: {outcomes[-1].inputs} inputs, {time.perf_counter() - begin_s:.0f} s", flush=True)
            for failure in outcomes[-1].failures:
                print(f"\n{target.name}, --seed {failure.seed}: {failure.shown}\n{failure.why}", flush=True)
    print(report(outcomes))
    return 1 if any(outcome.failures for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
