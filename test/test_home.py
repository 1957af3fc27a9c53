# SPDX-License-Identifier: BSD-3-Clause
"""The user's home folder is neither needed nor changed, and processes that start at once make no file twice."""

import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "scripts"


@pytest.fixture
def home(tmp_path):
    """A user's home folder to which nothing is to be added."""
    path = tmp_path / "home"
    path.mkdir()
    yield path
    assert list(path.iterdir()) == []


def environment(home, **variables):
    """Of a user, without what an outer pytest tells its own processes."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "USERS_HOME"))}
    return {**inherited, "HOME": str(home), **variables}


@pytest.mark.parametrize("usable", [True, False])
def test_workers_that_import_evo_and_matplotlib_at_once(home, tmp_path, usable):
    # A file is no folder, whoever asks, while permissions do not hold for root.
    folder = home if usable else Path(__file__)
    names = "test_absolute_errors_agree_with_evo"
    workers = ["--numprocesses", "2", "--dist", "load", "-p", "no:cacheprovider", "-k", names]
    module = ROOT / "test" / "evaluation" / "test_report.py"
    command = [sys.executable, "-m", "pytest", *workers, f"--basetemp={tmp_path / 'inner'}", str(module)]
    run = subprocess.run(command, cwd=ROOT, env=environment(folder), capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def sourcing(checkout, home, command, **variables):
    """What a command prints in a script of a checkout."""
    script = ["bash", "-c", f'set -euo pipefail; source "{SCRIPTS / "common.sh"}"; {command}']
    whole = environment(home, **variables)
    return subprocess.run(script, cwd=checkout, env=whole, check=True, stdout=subprocess.PIPE, text=True).stdout


@pytest.fixture
def checkout(tmp_path):
    path = tmp_path / "check out"
    path.mkdir()
    return path


def test_scripts_have_a_home_folder_inside_the_checkout(checkout, home):
    imports = f'"{sys.executable}" -c "import evo.tools.settings, matplotlib.font_manager"'
    variables = {"XDG_CACHE_HOME": str(home / ".cache"), "MPLCONFIGDIR": str(home / "matplotlib")}
    sourcing(checkout, home, imports, **variables)
    assert (checkout / ".ws" / "home" / ".evo").is_dir()
    assert list((checkout / ".ws" / "home" / ".cache" / "matplotlib").iterdir())


def nested(options, command):
    """A command of a script that another script starts, with options of env."""
    return f"""env {options} bash -c 'set -euo pipefail; source "{SCRIPTS / "common.sh"}"; {command}'"""


def test_a_script_that_another_one_starts_still_knows_the_users_home_folder(checkout, home):
    assert sourcing(checkout, home, nested("", 'echo "$USERS_HOME"')) == f"{home}\n"


def test_a_script_without_home_takes_the_accounts(checkout, home):
    accounts = pwd.getpwuid(os.getuid()).pw_dir
    assert sourcing(checkout, home, nested("-u HOME -u USERS_HOME", 'echo "$USERS_HOME"')) == f"{accounts}\n"


@pytest.mark.parametrize("place", ["later on PATH", "user/.pyenv/versions/3.8.18/bin"])
def test_python38_is_found_behind_one_that_fails(checkout, tmp_path, place):
    failing = executable(tmp_path / "first on PATH" / "python3.8", "exit 127")
    executable(tmp_path / place / "python3.8", f'exec "{sys.executable}" "$@"')
    path = f"{failing.parent}:{tmp_path / 'later on PATH'}:/usr/bin:/bin"
    found = sourcing(checkout, tmp_path / "user", "find_python38", PATH=path)
    assert found == f"{sys.executable}\n"


def executable(path, text):
    path.parent.mkdir(parents=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path
