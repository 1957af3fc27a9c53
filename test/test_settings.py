# SPDX-License-Identifier: BSD-3-Clause
import dataclasses
import math
import re

import pytest
import yaml

from ceiling_dso_ros.dso import OdometryConfig
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.settings import load_settings, merge_settings, plain_values, write_settings


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


@pytest.mark.parametrize("kind", [OdometryConfig, FusionConfig])
def test_what_is_written_is_yaml_for_roslaunch_too(tmp_path, kind):
    """The parameter server has no null: roslaunch would end with "cannot marshal None"."""
    path = tmp_path / "config.yaml"
    write_settings(path, kind())
    assert "null" not in path.read_text()
    assert yaml.safe_load(path.read_text()) == plain_values(kind())
    assert load_settings(path, kind=kind) == kind()


def test_an_empty_file_changes_nothing(tmp_path):
    assert load_settings(yaml_file(tmp_path, "# nothing\n"), []) == OdometryConfig()


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("window.max_keyframes", "--set window.max_keyframes: expected key=value"),
        ("=5", "--set =5: expected key=value"),
        (
            "window.max_keyframe=5",
            "--set window.max_keyframe=5: window.max_keyframe is unknown; did you mean window.max_keyframes?",
        ),
        ("windows.max_keyframes=5", "windows.max_keyframes is unknown; did you mean window.max_keyframes?"),
        ("max_keyframes=5", "max_keyframes is unknown; did you mean window.max_keyframes?"),
        ("window.max_keyframes.x=5", "window.max_keyframes.x is unknown; did you mean window.max_keyframes?"),
        ("xyz=5", "xyz is unknown; there are images, window, initialization"),
        ("tracking.cutoff=off", "tracking.cutoff: Value 'False' of type 'bool'"),
        ("tracking.cutoff=nan", "tracking.cutoff=nan: not a finite number"),
        ("initialization.densities=[0.1,.inf]", "initialization.densities=[0.1, inf]: not a finite number"),
        # Integers that no float or no int64 holds, or that Python does not read.
        ("tracking.cutoff=" + "9" * 310, "99: too large a number"),
        ("initialization.densities=[0.1," + "9" * 310 + "]", "99]: too large a number"),
        ("initialization.max_frames=" + "9" * 20, "initialization.max_frames=99999999999999999999: too large a number"),
        ("initialization.max_frames='" + "9" * 20 + "'", "initialization.max_frames=99999999999999999999: too large a"),
        ("tracking.cutoff=" + "9" * 5000, "--set tracking.cutoff=999"),
        ("tracking.cutoff=" + "[" * 3000, "--set tracking.cutoff=[[["),
        ("window.max_keyframes=many", "window.max_keyframes: Value 'many'"),
        ("window.max_keyframes=5.5", "window.max_keyframes: Value '5.5'"),
        ("window.max_keyframes=", "window.max_keyframes"),
        ("window=5", "--set window=5: window is a group of values, not one: max_keyframes, min_keyframes"),
        ("window.max_keyframes=[1", "--set window.max_keyframes=[1"),
        ("window.max_keyframes=${nowhere}", "window.max_keyframes"),
        (
            "window.max_keyframes=${window.min_keyframes}",
            "window.max_keyframes=${window.min_keyframes}: ${ is not allowed in a value",
        ),
        ("window.max_keyframes=???", "--set window.max_keyframes=???: window.max_keyframes=???: ??? is not a value"),
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
        ("initialization: {densities: [0.1, [0.2]]}", "densities=[0.1, [0.2]]: a list of values, not of further lists"),
        ("initialization: {densities: [0.1, ~]}", "densities=[0.1, None]: a value of the list is empty"),
        ("- 5", "expected names and values"),
        ("5", "expected names and values"),
        ("window: {max_frames: 5}", "window.max_frames is unknown; did you mean window.max_keyframes?"),
        ("tracking: {cutoff: " + "9" * 310 + "}", "99: too large a number"),
        ("tracking: {cutoff: " + "9" * 5000 + "}", "settings.yaml: "),
        ("5: 3", "5 is unknown; there are images"),
        ("window: {max_keyframes: many}", "window.max_keyframes: Value 'many'"),
        ("window: {max_keyframes: '${'}", "window.max_keyframes"),
        ("window: '${tracking}'", "window is a group of values"),
        ("window: {max_keyframes: '${.min_keyframes}'}", "window.max_keyframes=${.min_keyframes}: ${ is not allowed"),
        ("tracking: {cutoff: '???'}", "tracking.cutoff=???: ??? is not a value"),
        ("initialization: {densities: [0.5, '???']}", "initialization.densities=???: ??? is not a value"),
        ("initialization: {densities: '???'}", "initialization.densities=???: ??? is not a value"),
    ],
)
def test_wrong_files_are_named_in_one_line(tmp_path, text, complaint):
    path = yaml_file(tmp_path, text)
    with pytest.raises(InputError, match=re.escape(complaint)) as error:
        load_settings(path, [])
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda path: None, "cannot read the file: No such file"),
        (lambda path: path.mkdir(), "cannot read the file: Is a directory"),
        (lambda path: path.write_bytes(b"# \xff"), "is not a text file in UTF-8: byte 0xff in line 1"),
    ],
)
def test_unreadable_files_are_named(tmp_path, make, complaint):
    path = tmp_path / "settings.yaml"
    make(path)
    with pytest.raises(InputError, match=rf"settings\.yaml: {complaint}"):
        load_settings(path, [])


def test_settings_of_the_fusion(tmp_path):
    path = yaml_file(tmp_path, "scale: {ceiling_height_m: 6.5}\nwheels: {silence_s: 1.0}")
    config = load_settings(path, kind=FusionConfig)
    assert (config.scale.ceiling_height_m, config.wheels.silence_s) == (6.5, 1.0)
    with pytest.raises(InputError, match=r"wheels\.silence_s"):
        load_settings(yaml_file(tmp_path, "wheels: {silence_s: 100.0}"), kind=FusionConfig)


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (20, 20.0),  # as rosparam and roslaunch give a float without a point
        ("1e-5", 1e-5),  # a text in YAML 1.1
        ("deg(90)", math.radians(90)),
        ("rad(0.5)", 0.5),
    ],
)
def test_what_yaml_and_rosparam_make_of_a_number_is_understood(tmp_path, given, meant):
    cutoff = merge_settings(OdometryConfig, [("node", {"tracking": {"cutoff": given}})], "node").tracking.cutoff
    assert isinstance(cutoff, float)
    assert cutoff == meant
    assert load_settings(yaml_file(tmp_path, f"tracking: {{cutoff: {given}}}")).tracking.cutoff == meant
    assert load_settings(None, [f"tracking.cutoff={given}"]).tracking.cutoff == meant


@pytest.mark.parametrize("kind", [OdometryConfig, FusionConfig])
def test_what_the_parameter_server_holds_is_read_back(kind):
    values = plain_values(kind())
    assert merge_settings(kind, [("node", values)], "node") == kind()
    for group in values.values():
        assert {type(value) for value in group.values()} <= {int, float, bool, str, list}


def test_an_angle_has_a_number_in_its_parentheses():
    """Not by a file: where rosparam is imported, as by roslaunch, yaml itself refuses it."""
    layers = [("node", {"tracking": {"cutoff": "deg(pi)"}})]
    with pytest.raises(InputError, match=r"^node: deg\(pi\): expected a number in the parentheses$"):
        merge_settings(OdometryConfig, layers, "node")


def test_a_list_does_for_a_tuple_and_an_empty_text_for_none():
    densities = [0.1, 0.2, 0.3, 0.4, 1]
    config = merge_settings(OdometryConfig, [("node", {"initialization": {"densities": densities}})], "node")
    assert config.initialization.densities == tuple(densities)
    known = {"scale": {"ceiling_height_m": 6}}
    layers = [("file", known), ("node", {"scale": {"ceiling_height_m": ""}})]
    assert merge_settings(FusionConfig, layers[:1], "node").scale.ceiling_height_m == 6.0
    assert merge_settings(FusionConfig, layers, "node").scale.ceiling_height_m is None
    with pytest.raises(InputError, match=r"node: tracking\.cutoff: "):
        merge_settings(OdometryConfig, [("node", {"tracking": {"cutoff": ""}})], "node")
