import dataclasses
import re

import pytest

from ceiling_dso_ros.dso import OdometryConfig
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.settings import load_settings, write_settings


def yaml_file(tmp_path, text):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    return path


def test_without_anything_the_defaults_hold():
    assert load_settings(None, []) == OdometryConfig()


def test_the_command_line_wins_over_the_file_and_the_file_over_the_defaults(tmp_path):
    path = yaml_file(tmp_path, "window: {max_keyframes: 5, active_points: 800}")
    config = load_settings(path, ["window.max_keyframes=15", "window.max_keyframes=9"])
    assert (config.window.max_keyframes, config.window.active_points) == (9, 800)
    assert config.window.candidate_points == OdometryConfig().window.candidate_points
    assert load_settings(None, []) == OdometryConfig()


def test_what_is_written_is_read_back_and_holds_every_setting(tmp_path):
    config = load_settings(None, ["window.candidate_points=600"])
    write_settings(tmp_path / "config.yaml", config)
    assert load_settings(tmp_path / "config.yaml", []) == config
    text = (tmp_path / "config.yaml").read_text()
    for name in dataclasses.asdict(config)["window"]:
        assert name in text


def test_an_empty_file_changes_nothing(tmp_path):
    assert load_settings(yaml_file(tmp_path, "# nothing\n"), []) == OdometryConfig()


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("window.max_keyframes", "--set window.max_keyframes: expected key=value"),
        ("=5", "--set =5: expected key=value"),
        ("window.frames=5", "unknown setting window.frames; there are max_keyframes"),
        ("windows.max_keyframes=5", "unknown setting windows; there are window"),
        ("window.max_keyframes=many", "window.max_keyframes: Value 'many'"),
        ("window.max_keyframes=5.5", "window.max_keyframes: Value '5.5'"),
        ("window.max_keyframes=", "window.max_keyframes"),
        ("window=5", "--set window=5"),
        ("window.max_keyframes=[1", "--set window.max_keyframes=[1"),
        ("window.max_keyframes=${nowhere}", "window.max_keyframes"),
        ("window.max_keyframes=1000", "window.max_keyframes=1000: 3 to"),
    ],
)
def test_wrong_overrides_are_named_in_one_line(override, complaint):
    with pytest.raises(InputError, match=re.escape(complaint)) as error:
        load_settings(None, [override])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("window: [", "not valid yaml"),
        ("- 5", "expected names and values"),
        ("5", "expected names and values"),
        ("window: {frames: 5}", "unknown setting window.frames"),
        ("window: {max_keyframes: many}", "window.max_keyframes: Value 'many'"),
        ("window: {max_keyframes: '${'}", "window.max_keyframes"),
    ],
)
def test_wrong_files_are_named_in_one_line(tmp_path, text, complaint):
    path = yaml_file(tmp_path, text)
    with pytest.raises(InputError, match=re.escape(complaint)) as error:
        load_settings(path, [])
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("make", [lambda path: None, lambda path: path.mkdir(), lambda path: path.write_bytes(b"\xff")])
def test_unreadable_files_are_named(tmp_path, make):
    path = tmp_path / "settings.yaml"
    make(path)
    with pytest.raises(InputError, match=r"settings\.yaml: cannot read"):
        load_settings(path, [])


def test_settings_of_the_fusion(tmp_path):
    path = yaml_file(tmp_path, "scale: {ceiling_height_m: 6.5}\nwheels: {silence_s: 1.0}")
    config = load_settings(path, kind=FusionConfig)
    assert (config.scale.ceiling_height_m, config.wheels.silence_s) == (6.5, 1.0)
    with pytest.raises(InputError, match=r"wheels\.silence_s"):
        load_settings(yaml_file(tmp_path, "wheels: {silence_s: 100.0}"), kind=FusionConfig)
