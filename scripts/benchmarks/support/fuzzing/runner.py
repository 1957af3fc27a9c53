# SPDX-License-Identifier: BSD-3-Clause
"""Runs the targets of the fuzzing, with a deadline and a bound of the memory for each input."""

import faulthandler
import resource
import signal
import time
import traceback
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import FrameType
from typing import Callable, Iterator, List, Optional, Tuple

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis import strategies as st
from support.fuzzing.rules import USED, BrokenRuleError

DEADLINE_S = 10.0  # of one input, on a busy machine; a usual one takes milliseconds
STUCK_S = 120.0  # after which the process ends and says where it is, because compiled code heeds no deadline
MOST_MEMORY_MB = 400.0  # that one input takes more than those before
ADDRESSES = 2**31  # bytes that may be asked for beyond what the process has when it begins
BATCH = 200  # inputs of one seed; a node of a target begins anew with each
MOST_FAILURES = 5  # of a target, each with a batch of its own
SHOWN = 1500  # characters of an input

# The input for messages, and what uses it and returns USED or REFUSED.
Case = Tuple[object, Callable[[], str]]


class DeadlineError(BaseException):
    """An input takes too long; nothing that catches errors catches this."""


@dataclass(frozen=True)
class Target:
    """Something that reads inputs.

    Attributes:
        name: as the table has it.
        count: inputs of a full run.
        begin: gives what makes an input of a batch, from valid ones.
        has_state: an input may depend on those before it in the batch, so that a failure cannot be made smaller.
    """

    name: str
    count: int
    begin: Callable[[], Callable[[Random], Case]]
    has_state: bool = False


@dataclass(frozen=True)
class Failure:
    """An input that breaks a rule."""

    seed: int
    shown: str
    why: str


@dataclass
class Outcome:
    """What became of the inputs of a target."""

    name: str
    inputs: int = 0
    used: int = 0
    slowest_s: float = 0.0
    failures: List[Failure] = field(default_factory=list)


def run(target: Target, first_seed: int, count: int) -> Outcome:
    """Have a target use a number of inputs, in batches with seeds of their own."""
    outcome = Outcome(target.name)
    batch_seed = first_seed
    while outcome.inputs < count and len(outcome.failures) < MOST_FAILURES:
        _Batch(target, outcome, batch_seed).run(min(BATCH, count - outcome.inputs))
        batch_seed += 1
    return outcome


class _Batch:
    def __init__(self, target: Target, outcome: Outcome, batch_seed: int) -> None:
        self._target, self._outcome, self._seed = target, outcome, batch_seed
        self._make = target.begin()
        self._failure: Optional[Failure] = None

    def run(self, count: int) -> None:
        """Use so many inputs, fewer after one that breaks a rule."""
        _forget_peak()
        phases = (Phase.generate,) if self._target.has_state else (Phase.generate, Phase.shrink)
        options = settings(
            max_examples=count,
            database=None,
            deadline=None,
            phases=phases,
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
        )

        # What depends on a target's state would look like another choice to hypothesis, so it chooses a seed only.
        randoms = st.randoms(use_true_random=self._target.has_state)

        def use(random: Random) -> None:
            self._use(random)

        before = self._outcome.inputs
        try:
            seed(self._seed)(options(given(randoms)(use)))()
        except KeyboardInterrupt:
            raise
        except BaseException:
            if self._failure is None:
                raise
        if self._failure is not None:
            self._outcome.failures.append(self._failure)
        elif self._outcome.inputs == before:
            raise RuntimeError(f"{self._target.name}: no input was made")

    def _use(self, random: Random) -> None:
        if self._failure is not None and self._target.has_state:  # hypothesis tries it again
            raise BrokenRuleError(self._failure.why)
        value, act = self._make(random)
        before_s, before_mb = time.perf_counter(), _peak_mb()
        self._outcome.inputs += self._failure is None
        try:
            with _deadline():
                result = act()
            if _peak_mb() > before_mb + MOST_MEMORY_MB:
                raise BrokenRuleError(f"takes {_peak_mb() - before_mb:.0f} MB")
        except (Exception, DeadlineError) as error:
            why = "".join(traceback.format_exception(type(error), error, error.__traceback__))
            self._failure = Failure(self._seed, repr(value)[:SHOWN], why)
            _forget_peak()
            raise
        if self._failure is None:
            self._outcome.used += result == USED
            self._outcome.slowest_s = max(self._outcome.slowest_s, time.perf_counter() - before_s)


@contextmanager
def _deadline() -> Iterator[None]:
    def ring(_number: int, _frame: Optional[FrameType]) -> None:
        raise DeadlineError(f"takes more than {DEADLINE_S:g} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, DEADLINE_S)
    faulthandler.dump_traceback_later(STUCK_S, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def limit_addresses() -> None:
    """Let requests for much more memory than the process has now fail, also for memory that is never written to."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    _, largest = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ADDRESSES, largest))


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")
