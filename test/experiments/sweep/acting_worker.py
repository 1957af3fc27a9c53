# SPDX-License-Identifier: BSD-3-Clause
"""A process for runs that does what the run's sequence says, without the odometry."""

import os
import signal
import time
from pathlib import Path

from ceiling_dso_ros.experiments.sweep.answering import answer_jobs


def act(spec, folder, timed):
    sequence = spec["sequence"]
    print("about to", sequence)
    if sequence == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if sequence == "killed_once":
        trace = Path(spec["input"]).with_suffix(".tried")
        if not trace.exists():
            trace.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if sequence == "hang":
        time.sleep(600.0)
    if sequence == "eat":
        eaten = [bytearray(os.urandom(1) * 10_000_000) for _ in range(100)]
        time.sleep(600.0 + len(eaten))
    if sequence == "fail":
        raise ValueError("what nobody\nexpected")
    if sequence == "cores":
        return {"frames": len(os.sched_getaffinity(0)), "keyframes": int(timed)}
    (folder / "camera.tum").write_text(f"{spec['seed']}\n")
    return {"frames": 3 + spec["seed"]}


if __name__ == "__main__":
    answer_jobs(lambda: None, act)
