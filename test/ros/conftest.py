# SPDX-License-Identifier: BSD-3-Clause
"""A master of our own, commands with the setup of the workspace's spaces, and a drive; for tests that start nodes.

The helpers of this directory can be imported from its test files.
"""

import os
import shlex
import signal
import socket
import subprocess
import sys
import xmlrpc.client
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]

sys.path.insert(0, str(Path(__file__).parent))

from waiting import PATIENCE_S, wait_until  # noqa: E402


@pytest.fixture(scope="session")
def bag(tmp_path_factory):
    """A drive that several tests play; in a folder whose name takes some care."""
    from launched import render_drive

    path = tmp_path_factory.mktemp("drive") / 'it\'s "a" drive' / "drive.bag"
    path.parent.mkdir()
    render_drive(path)
    return path


@pytest.fixture
def ros_home(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "ros"))
    return tmp_path / "ros"


@pytest.fixture
def rosless(ros_home, monkeypatch):
    """Makes worlds for servers without a master; they end with the test."""
    from rosless import Rosless

    made = []

    def make(**parameters):
        made.append(Rosless(monkeypatch, **parameters))
        return made[-1]

    yield make
    for world in made:
        world.end()


@pytest.fixture
def in_space():
    """Makes the command that runs another one as a shell does that has sourced a space's setup, devel or install."""

    def command(space, words):
        setup = shlex.quote(str(CHECKOUT / ".ws" / space / "setup.bash"))
        scripts = shlex.quote(str(CHECKOUT / ".venv" / "bin"))
        return ["bash", "-c", f"source {setup} && PATH={scripts}:$PATH exec {shlex.join(words)}"]

    return command


@pytest.fixture
def environment(tmp_path):
    """Of nodes at a master of our own."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_HOSTNAME", "PYTHON"))}
    return {
        **environment,
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }


@pytest.fixture
def master(environment, in_space):
    """Its API; it ends with the test."""
    uri = environment["ROS_MASTER_URI"]
    command = in_space("devel", ["roscore", "-p", uri.rpartition(":")[2]])
    core = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
    proxy = xmlrpc.client.ServerProxy(uri)
    try:
        wait_until(lambda: proxy.getPid("/test")[0] == 1, process=core)
        yield proxy
    finally:
        core.send_signal(signal.SIGINT)
        core.wait(PATIENCE_S)
