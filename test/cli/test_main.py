# SPDX-License-Identifier: BSD-3-Clause
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from xml.etree import ElementTree

import pytest

import ceiling_dso_ros
import ceiling_dso_ros.version as version_module
from ceiling_dso_ros.cli import main as main_module
from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.io.errors import InputError, OutputError


def command_that(error):
    """A command module whose execute raises error, or nothing."""

    class Command:
        @staticmethod
        def add_parser(commands):
            def execute(options):
                if error is not None:
                    raise error

            commands.add_parser("try").set_defaults(execute=execute)

    return Command


def no_such_package(name):
    raise PackageNotFoundError(name)


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (None, 0, ""),
        (InputError("a.tum: broken"), 2, "error: a.tum: broken\n"),
        (OutputError("b.tum: disk full"), 1, "error: b.tum: disk full\n"),
        (KeyboardInterrupt(), 130, "error: interrupted\n"),
        (ValueError("two\nlines"), 1, "error: ValueError: two lines; python3 -X dev -m ceiling_dso_ros shows where\n"),
    ],
)
def test_exit_codes_and_their_line(monkeypatch, capsys, error, code, line):
    monkeypatch.setattr(main_module, "COMMANDS", (command_that(error),))
    assert main(["try"]) == code
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("arguments", [[], ["fly"], ["try", "--hard"]])
def test_wrong_usage_is_one_line(monkeypatch, capsys, arguments):
    monkeypatch.setattr(main_module, "COMMANDS", (command_that(None),))
    with pytest.raises(SystemExit) as error:
        main(arguments)
    assert error.value.code == 2
    complaint = capsys.readouterr().err
    assert complaint.startswith("error: ")
    assert complaint.endswith("--help\n")
    assert complaint.count("\n") == 1


def test_the_home_folder_is_meant_also_where_the_shell_does_not_say_so(monkeypatch):
    """As in --out=~/drive."""
    found = []

    class Command:
        @staticmethod
        def add_parser(commands):
            parser = commands.add_parser("try")
            parser.add_argument("--out", type=Path)
            parser.set_defaults(execute=lambda options: found.append(options.out))

    monkeypatch.setattr(main_module, "COMMANDS", (Command,))
    monkeypatch.setenv("HOME", "/home/somebody")
    for words in (["--out=~/drive"], ["--out", "drive~"], []):
        assert main(["try", *words]) == 0
    assert found == [Path("/home/somebody/drive"), Path("drive~"), None]


def test_version_is_that_of_the_manifest(command):
    version = ElementTree.parse(Path(__file__).parents[2] / "package.xml").findtext("version")
    assert ceiling_dso_ros.__version__ == version
    result = command("--version")
    assert (result.returncode, result.stdout) == (0, f"{version}\n")


def test_version_of_copied_sources_is_unknown(monkeypatch, tmp_path):
    monkeypatch.setattr(version_module, "__file__", str(tmp_path / "src" / "ceiling_dso_ros" / "version.py"))
    monkeypatch.setattr(version_module, "version", no_such_package)
    assert version_module.find_version() == version_module.UNKNOWN


@pytest.mark.parametrize("words", [[], ["run"], ["evaluate"]])
def test_help_names_what_there_is(command, words):
    result = command(*words, "--help")
    assert result.returncode == 0
    for text in {(): ["run", "evaluate"], ("run",): ["INPUT", "--out"], ("evaluate",): ["DIR", "--reference"]}[
        tuple(words)
    ]:
        assert text in result.stdout


def test_help_waits_for_no_library(command):
    """Each of them takes a second or so to import; a command asks for them when it is executed."""
    result = command("run", "--help", interpreter_options=["-X", "importtime"])
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in result.stderr.splitlines()}
    assert "ceiling_dso_ros" in imported
    assert not imported & {"numpy", "numba", "scipy", "cv2", "gtsam", "matplotlib", "rosbags", "omegaconf", "yaml"}


def test_program_is_called_what_it_was_called(monkeypatch, capsys):
    for started_as, name in (("/usr/bin/ceiling-dso", "ceiling-dso"), ("__main__.py", "python3 -m ceiling_dso_ros")):
        monkeypatch.setattr(main_module.sys, "argv", [started_as])
        with pytest.raises(SystemExit):
            main(["--help"])
        assert capsys.readouterr().out.startswith(f"usage: {name} [-h]")
