# SPDX-License-Identifier: BSD-3-Clause
"""What a yaml file with settings may not do: run code, take memory, or say one thing twice."""

import re

import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.robot_file import read_robot_file
from ceiling_dso_ros.io.yaml_files import read_yaml
from ceiling_dso_ros.settings import load_settings

LAUGHS = "\n".join(
    ["a: &a [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    + [f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]" for before, name in zip("abcdefgh", "bcdefghi")]
)
NESTED_MERGES = "\n".join(
    ["a: &a {x: 1}"]
    + [f"{name}: &{name} {{k: *{before}, l: *{before}}}" for before, name in zip("abcdefghijklmno", "bcdefghijklmnop")]
)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (LAUGHS, "more than 10000 values"),
        (NESTED_MERGES, "more than 10000 values"),
        ("a: &a [1, *a]", "a value contains itself"),
        ("[" * 500, "too deeply nested"),
        ("{a: " * 1000, "too deeply nested"),
        ("wheel_base: 1\nwheel_base: 2\n", "wheel_base is there twice, again in line 2"),
        ("a: !!python/object/apply:os.system [touch pwned]", "could not determine a constructor"),
        ("a: !!python/name:os.system", "could not determine a constructor"),
        ("a: 2001-13-45", "month must be in 1..12"),
        ("a: !!int x", "invalid literal for int"),
        ("a: \x01", "special characters are not allowed"),
        ("a: 1\n---\nb: 2\n", "expected a single document"),
    ],
    ids=[
        *(
            "laughs",
            "nested mappings",
            "a loop",
            "deep lists",
            "deep mappings",
            "a name twice",
            "an object",
            "a function",
        ),
        *("a date", "a tag", "a control character", "two documents"),
    ],
)
def test_what_is_no_file_with_settings(tmp_path, monkeypatch, text, complaint):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    for read in (read_yaml, read_robot_file, load_settings):
        with pytest.raises(InputError, match=re.escape(f"{path}: is not valid yaml: ")) as caught:
            read(path)
        assert complaint in str(caught.value)
        assert str(caught.value).isprintable()
    assert not (tmp_path / "pwned").exists()


def test_references_are_allowed(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: &r 0.1\nb: [*r, *r]\nc: &c {d: 1}\ne: {<<: *c, f: 2}\n")
    assert read_yaml(path) == {"a": 0.1, "b": [0.1, 0.1], "c": {"d": 1}, "e": {"d": 1, "f": 2}}


def test_an_empty_file_has_no_values(tmp_path):
    (tmp_path / "a.yaml").write_text("# nothing\n")
    assert read_yaml(tmp_path / "a.yaml") is None


def test_a_gigabyte_is_not_read(tmp_path):
    path = tmp_path / "robot.yaml"
    with path.open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InputError, match=re.escape(f"{path}: has more than 100000 bytes, which no file with settings")):
        read_robot_file(path)
