import pytest

import ceiling_dso_ros
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


def test_version(command):
    result = command("--version")
    assert (result.returncode, result.stdout) == (0, f"{ceiling_dso_ros.__version__}\n")


@pytest.mark.parametrize("words", [[], ["run"], ["evaluate"]])
def test_help_names_what_there_is(command, words):
    result = command(*words, "--help")
    assert result.returncode == 0
    for text in {(): ["run", "evaluate"], ("run",): ["INPUT", "--out"], ("evaluate",): ["DIR", "--reference"]}[
        tuple(words)
    ]:
        assert text in result.stdout
