# SPDX-License-Identifier: BSD-3-Clause
"""When the mapping runs: at once, or in its own thread beside the tracking."""

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, Callable, Deque, List

Task = Callable[[], Any]


class SequentialScheduler:
    """Runs every task at once: the same input gives the same results, and the caller waits for them."""

    def __init__(self) -> None:
        self._futures: Deque[Future] = deque()

    @property
    def backlog(self) -> int:
        """Number of tasks that have not ended."""
        return sum(not future.done() for future in self._futures)

    def submit(self, task: Task) -> None:
        """Do a task."""
        future: Future = Future()
        try:
            future.set_result(task())
        except Exception as error:  # raised where the result is asked for, as with a thread
            future.set_exception(error)
        self._futures.append(future)

    def take_results(self) -> List[Any]:
        """Results of the tasks that have ended, in their order; each result is given once.

        An exception of a task is raised here, after the results of the tasks before it were taken.
        """
        results: List[Any] = []
        while self._futures and self._futures[0].done():
            if results and self._futures[0].exception() is not None:
                break
            results.append(self._futures.popleft().result())
        return results

    def wait(self) -> None:
        """Return when every task has ended."""
        wait(self._futures)

    def discard(self) -> None:
        """Forget the results of all tasks; returns when the last has ended."""
        self.wait()
        self._futures.clear()

    def close(self) -> None:
        """End; no task may follow."""


class LiveScheduler(SequentialScheduler):
    """Does tasks one after the other in a thread, so that tracking never waits for the bundle adjustment."""

    def __init__(self) -> None:
        super().__init__()
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="mapping")

    def submit(self, task: Task) -> None:
        """Queue a task."""
        self._futures.append(self._executor.submit(task))

    def close(self) -> None:
        """Return when every task has ended, and end the thread."""
        self._executor.shutdown()
