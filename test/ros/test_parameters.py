# SPDX-License-Identifier: BSD-3-Clause
"""Reading of private parameters, with a parameter server of our own."""

from dataclasses import fields

import pytest

pytest.importorskip("ceiling_dso_ros.cfg", reason="needs ROS and the built workspace")

import rospy

from ceiling_dso_ros.cfg import DsoConfig, FusionOutputConfig
from ceiling_dso_ros.cfg import FusionConfig as FusionReconfigureConfig
from ceiling_dso_ros.dso import OdometryConfig
from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.fusion.config import FusionConfig, OutputConfig
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.ros import parameters
from ceiling_dso_ros.ros.node_parameters import DsoParameters, FusionParameters, SimulationParameters, WheelParameters
from ceiling_dso_ros.ros.robot_parameter import ROBOT_GROUP, read_robot
from ceiling_dso_ros.settings import plain_values

ROBOT = {"ticks_per_turn": 4096, "wheel_radius": [0.1, 0.1], "wheel_base": 0.5}
SERVER_TYPES = {bool, int, float, str, list, dict}  # what the parameter server takes

pytestmark = pytest.mark.ros


@pytest.fixture
def server(monkeypatch):
    """The private parameters of `/node`, nested."""
    values = {}

    def get_param(name, default):
        assert name[0] == "~"
        return values.get(name[2:] if name[1:2] == "/" else name[1:], default) if name != "~" else dict(values)

    monkeypatch.setattr(rospy, "get_param", get_param)
    monkeypatch.setattr(rospy, "set_param", lambda name, value: values.__setitem__(name[1:], value))
    monkeypatch.setattr(rospy, "get_name", lambda: "/node")
    monkeypatch.setattr(rospy, "resolve_name", lambda name: f"/node/{name[1:]}")
    return values


def test_what_is_set_counts_and_all_is_shown_afterwards(server):
    server.update(image_transport="compressed", silence=2, window={"max_keyframes": 7}, tracking={"cutoff": "1e1"})
    own, config = parameters.read(DsoParameters, OdometryConfig)
    assert (own.image_transport, own.silence, own.mapping) == ("compressed", 2.0, "live")
    assert (config.window.max_keyframes, config.tracking.cutoff) == (7, 10.0)
    assert set(server) == {field.name for kind in (DsoParameters, OdometryConfig) for field in fields(kind)}
    assert server["window"] == {**server["window"], "max_keyframes": 7, "active_points": 1000}
    assert (server["tracking"]["cutoff"], server["silence"]) == (10.0, 2.0)
    assert {type(value) for value in server.values()} <= SERVER_TYPES
    again = parameters.read(DsoParameters, OdometryConfig)
    assert again == (own, config)


def test_nothing_is_written_that_is_there_already(server, monkeypatch):
    parameters.read(FusionParameters, FusionConfig)
    monkeypatch.setattr(rospy, "set_param", lambda *_: pytest.fail("written again"))
    parameters.read(FusionParameters, FusionConfig)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"publish_ft": True}, "/node: publish_ft is unknown; did you mean publish_tf?"),
        ({"outputs": {"blend_s": 1.0}}, "/node: outputs/blend_s is unknown; did you mean output/blend_s?"),
        ({"blend_s": 1.0}, "/node: blend_s is unknown; did you mean output/blend_s?"),
        ({"robots": {"wheel_base": 1.0}}, "/node: robots/wheel_base is unknown; did you mean robot/wheel_base?"),
        ({"settings": "fusion.yaml"}, "/node: settings is unknown; "),
        ({"output": {"blend_s": 100.0}}, "/node: output/blend_s=100.0: 0.01 to 10"),
        ({"output": {"blend_s": "slow"}}, "/node: output/blend_s: Value 'slow'"),
        ({"silence": False}, "/node: silence: Value 'False'"),
        ({"silence": 100}, "/node: silence=100.0: 0.1 to 60"),
        ({"tf_mode": "both"}, "/node: tf_mode=both: odom or correction"),
        ({"odom_frame": "/"}, "/node: odom_frame=/: the name of a frame"),
        ({"odom_frame": "base_link"}, "/node: odom_frame and base_frame are both base_link: two frames are needed"),
        ({"odom_frame": "/a", "base_frame": "a"}, "/node: odom_frame and base_frame are both a: two frames are needed"),
        ({"publish_tf": "maybe"}, "/node: publish_tf: Value 'maybe'"),
        ({"publish_tf": 2}, "/node: publish_tf=2: true or false"),
        ({"publish_tf": 1.0}, "/node: publish_tf=1.0: true or false"),
        ({"silence": "???"}, "/node: silence=???: ??? is not a value"),
        ({"odom_frame": "${base_frame}"}, "/node: odom_frame=${base_frame}: ${ is not allowed in a value"),
        ({"trajectory_dir": "/a/${b"}, "/node: trajectory_dir=/a/${b: ${ is not allowed in a value"),
        ({"output": {"blend_s": "${oc.env:HOME}"}}, "/node: output/blend_s=${oc.env:HOME}: ${ is not allowed"),
        ({"covariance_scale": 0.0}, "/node: covariance_scale=0.0: 0.001 to 1e+06"),
        ({"path_length": 1.5}, "/node: path_length: Value '1.5'"),
    ],
)
def test_wrong_parameters_are_refused_in_one_line_and_none_is_written(server, given, complaint):
    server.update(given)
    with pytest.raises(InputError) as caught:
        parameters.read(FusionParameters, FusionConfig, groups=ROBOT_GROUP)
    assert str(caught.value).startswith(complaint)
    assert "\n" not in str(caught.value)
    assert server == given


@pytest.mark.parametrize("value", [5, 0, "text", [1, 2], []])
def test_a_namespace_that_is_one_value_is_refused_in_one_line(server, monkeypatch, value):
    """As after `rosparam set /node 5`."""
    monkeypatch.setattr(rospy, "get_param", lambda name, default: value)
    with pytest.raises(
        InputError, match=r"^/node: holds one value, .*, instead of parameters; .*rosparam delete /node$"
    ):
        parameters.read(FusionParameters, FusionConfig, groups=ROBOT_GROUP)
    assert server == {}


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"base_frame": "odom"}, "/node: odom_frame and base_frame are both odom: two frames are needed"),
        ({"left_joint": "wheel", "right_joint": "wheel"}, "/node: left_joint and right_joint are both wheel"),
    ],
)
def test_the_names_of_wheels_and_frames_differ(server, given, complaint):
    server.update(given)
    with pytest.raises(InputError) as caught:
        parameters.read(WheelParameters)
    assert str(caught.value).startswith(complaint)
    assert "\n" not in str(caught.value)
    assert server == given


@pytest.mark.parametrize("text", ["100", "64*64", "64x", "0x0", "0x480", "848x00"])
def test_an_image_size_is_two_numbers(server, text):
    server["image_size"] = text
    with pytest.raises(InputError, match=r"/node: image_size .*: expected WIDTHxHEIGHT"):
        parameters.read(DsoParameters, OdometryConfig)


@pytest.mark.parametrize("text", ["~no-such-user/a", "/a\0b", "/a\ud800"])
def test_what_cannot_be_a_path_is_refused_in_one_line(text):
    for read in (parameters.file_path, parameters.output_folder):
        with pytest.raises(InputError) as caught:
            read(text)
        assert str(caught.value).isprintable()


@pytest.mark.parametrize("frame_rate", [1e-300, 1e-4])
def test_a_rate_below_one_image_an_hour_is_refused(server, frame_rate):
    server["frame_rate"] = frame_rate
    with pytest.raises(InputError, match=rf"^/node: frame_rate={frame_rate:g}: 0 for all images, or .*more a second$"):
        parameters.read(DsoParameters, OdometryConfig)


@pytest.mark.parametrize("kind", [DsoParameters, WheelParameters, FusionParameters, SimulationParameters])
def test_defaults_are_right_and_of_types_that_the_parameter_server_knows(kind):
    kind().check()
    assert {type(value) for value in plain_values(kind()).values()} <= SERVER_TYPES


def test_the_robot_is_read_and_shown_complete(server):
    server["robot"] = dict(ROBOT)
    model, has_camera = read_robot()
    assert (model.wheel_base_m, model.ticks_per_turn, has_camera) == (0.5, 4096.0, False)
    assert server["robot"] == {**ROBOT, "T_base_camera": "", "camera_time_offset": 0.0}
    assert read_robot()[1] is False
    server["robot"]["T_base_camera"] = {"xyz": [0.1, 0, 0.6], "quat_xyzw": [0, 0, 0, 1]}
    model, has_camera = read_robot()
    assert (model.T_base_camera[2, 3], has_camera) == (0.6, True)
    parameters.read(FusionParameters, FusionConfig, groups=ROBOT_GROUP)


@pytest.mark.parametrize(
    ("robot", "complaint"),
    [
        ({}, "/node/robot: has no ticks_per_turn, wheel_radius and wheel_base; load a robot.yaml"),
        ("/path/robot.yaml", "/node/robot: has no ticks_per_turn"),
        ({**ROBOT, "wheel_bse": 1}, "/node/robot: wheel_bse is unknown; did you mean wheel_base?"),
        ({**ROBOT, "wheel_base": -1}, "/node/robot: wheel_base must be a positive number, not -1"),
        ({**ROBOT, "wheel_base": 0.001}, "/node/robot: robot.wheel_base_m=0.001: 0.01 to 20"),
        ({**ROBOT, "wheel_base": 485}, "/node/robot: wheel_base has 485 m, no robot is so large; it is given in m"),
        (
            {**ROBOT, "T_base_camera": {"xyz": [0, 0, 1], "quat_xyzw": [1, 0, 0, 0]}},
            "/node/robot: robot.T_base_camera: the camera must look up",
        ),
    ],
)
def test_a_wrong_robot_is_refused_in_one_line(server, robot, complaint):
    server["robot"] = robot
    with pytest.raises(InputError) as caught:
        read_robot()
    assert str(caught.value).startswith(complaint)
    assert "\n" not in str(caught.value)


def test_reconfiguring_the_output_knows_its_defaults_and_its_ranges():
    assert {name for name in FusionOutputConfig.defaults if name != "groups"} == {f.name for f in fields(OutputConfig)}
    for field in fields(OutputConfig):
        assert FusionOutputConfig.defaults[field.name] == field.default
        for limits, beyond in ((FusionOutputConfig.min, 0.999), (FusionOutputConfig.max, 1.001)):
            limit = limits[field.name]
            OutputConfig(**{field.name: limit}).check()
            with pytest.raises(ConfigError, match=field.name):
                OutputConfig(**{field.name: beyond * limit}).check()


@pytest.mark.parametrize(("kind", "config"), [(DsoParameters, DsoConfig), (FusionParameters, FusionReconfigureConfig)])
def test_all_that_is_reconfigured_is_a_parameter(kind, config):
    names = {name for name in config.defaults if name != "groups"}
    assert names <= {field.name for field in fields(kind)}
    for name in names:
        assert getattr(kind(), name) == config.defaults[name]
