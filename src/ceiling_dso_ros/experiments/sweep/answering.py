# SPDX-License-Identifier: BSD-3-Clause
"""The side of the process that carries runs out: jobs come as lines of JSON, and each is answered with a line."""

import faulthandler
import json
import os
import signal
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import Any, Callable, Dict, Tuple

from ceiling_dso_ros.io.errors import InputError, OutputError, one_line

READY = "ready"
DONE = "done"  # status of a run that has numbers
LOG = "log.txt"
PARENT_S = 1.0  # how often it is looked whether the parent is still there
# spec, folder, timed -> the numbers of the run
Work = Callable[[Dict[str, Any], Path, bool], Dict[str, Any]]


def answer_jobs(prepare: Callable[[], None], work: Work) -> None:
    """Answer jobs until the standard input ends. What a run prints goes into the run's own log.

    Args:
        prepare: is called once, before the first job is waited for.
        work: carries a run out.
    """
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # what is said last before a crash
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which then ends this process
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    prepare()
    print(READY, file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(_answer(json.loads(line), work)), file=answers, flush=True)


def _answer(job: Dict[str, Any], work: Work) -> Dict[str, Any]:
    """Status, message and numbers."""
    folder = Path(job["folder"])
    with (folder / LOG).open("wb", buffering=0) as log:
        sys.stdout.flush()
        for stream in (sys.stdout, sys.stderr):
            os.dup2(log.fileno(), stream.fileno())
        os.sched_setaffinity(0, job["cores"])
        status, message, numbers = _outcome(lambda: work(job["spec"], folder, job["timed"]))
        sys.stdout.flush()
        sys.stderr.flush()
    return {"status": status, "message": one_line(" ".join(message.split())), "numbers": numbers}


def _outcome(work: Callable[[], Dict[str, Any]]) -> Tuple[str, str, Dict[str, Any]]:
    try:
        return DONE, "", work()
    except MemoryError as error:
        return "starved", f"MemoryError: {error}", {}
    except (InputError, OutputError) as error:
        return "failed", str(error), {}
    except Exception as error:
        traceback.print_exc()
        return "failed", f"{type(error).__name__}: {error}", {}


def _end_with(parent: int) -> None:
    """End this process when its parent has died: nobody waits for its answers."""
    while os.getppid() == parent:
        time.sleep(PARENT_S)
    os._exit(1)
