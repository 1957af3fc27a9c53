# SPDX-License-Identifier: BSD-3-Clause
"""The warm-up reaches every kernel of the map, or says that it did not."""

import os
import subprocess
import sys
from pathlib import Path

from ceiling_dso_ros.slam import warmup


def test_what_maps_do_compiles_nothing_more():
    """In a process of its own: what other tests have compiled does not count."""
    script = """
import painted_ceiling as ceiling
from ceiling_dso_ros.dso.compute import jit
from ceiling_dso_ros.slam import warmup
from ceiling_dso_ros.slam.localiser import Localiser
from ceiling_dso_ros.slam.builder import SiteBuilder

def signatures():
    return sum(len(kernel.signatures) for kernel in jit._compiled)

assert warmup.warm_up()
warm = signatures()
texture, poses = ceiling.paint(10), ceiling.round_trip(1.2, 0.2, 20)
builder = SiteBuilder(ceiling.RECORD_CAMERA)
for number, pose in enumerate(poses):
    builder.add(ceiling.record(texture, pose, number, pose))
localiser = Localiser(builder.site())
localiser.add(ceiling.record(texture, poses[1], 1, poses[1], seed=3))
assert localiser.hypotheses
print(warm, signatures())
"""
    folders = [str(Path(__file__).parent), *(path for path in sys.path if path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    result = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    before, after = map(int, result.stdout.split()[-2:])
    assert before == after > 0


def test_it_says_when_it_did_not(monkeypatch, capsys):
    monkeypatch.setattr(warmup, "warm_up", lambda: False)
    monkeypatch.setattr(warmup, "_marker", lambda: None)
    assert warmup.main() == 1
    assert "not compiled" in capsys.readouterr().err
