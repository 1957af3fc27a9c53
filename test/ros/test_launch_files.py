# SPDX-License-Identifier: BSD-3-Clause
"""The launch files as roslaunch reads them: nothing is started."""

import re
import shlex
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.cfg", reason="needs ROS and the built workspace")

import rospy
from roslaunch.arg_dump import get_args
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader

from ceiling_dso_ros.cfg import DsoConfig, FusionConfig
from ceiling_dso_ros.dso import OdometryConfig
from ceiling_dso_ros.fusion.config import FusionConfig as FusionSettings
from ceiling_dso_ros.io.bag_contents import BagContents
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.known_names import require_known
from ceiling_dso_ros.io.robot_file import robot_from_values
from ceiling_dso_ros.ros import playback_gate
from ceiling_dso_ros.ros.node_parameters import DsoParameters, FusionParameters, SimulationParameters, WheelParameters
from ceiling_dso_ros.settings import default_values, merge_settings

pytestmark = pytest.mark.ros

LAUNCH = Path(__file__).parents[2] / "launch"
PARTS = ("dso", "fusion")
WHOLES = ("ceiling_odometry", "playback", "simulation")
NODES = {
    "dso_node": (DsoParameters, OdometryConfig),
    "wheel_odometry_node": (WheelParameters,),
    "fusion_node": (FusionParameters, FusionSettings),
    "simulation_node": (SimulationParameters,),
}
# Not arguments: they may change while the nodes run, or belong to a robot without fusion.
NOT_LAUNCHED = {
    "dso_node": set(DsoConfig.defaults) - {"groups", "frame_rate"},
    "wheel_odometry_node": {"publish_tf", "wheels"},
    "fusion_node": set(FusionConfig.defaults) - {"groups"},
    "simulation_node": set(),
}
OTHER_VALUES = {"wheel_input": "ticks", "respawn": "true", "required": "true"}


def load(name, *arguments):
    config = ROSLaunchConfig()
    XmlLoader().load(str(LAUNCH / f"{name}.launch"), config, argv=list(arguments), verbose=False)
    return config


def declared(name):
    """{argument: (doc, default)} of a launch file."""
    return get_args([str(LAUNCH / f"{name}.launch")])


def default_of(name, argument):
    return declared(name)[argument][1]


def nested(config, node):
    """The private parameters of a node."""
    values = {}
    for name, parameter in config.params.items():
        if name.startswith(f"/{node}/"):
            *groups, leaf = name.split("/")[2:]
            group = values
            for each in groups:
                group = group.setdefault(each, {})
            group[leaf] = parameter.value
    return values


def state(config):
    """What is launched of the nodes that odometry and fusion have."""
    found = {name: parameter.value for name, parameter in config.params.items()}
    for node in config.nodes:
        found[f"{node.name}/respawn"], found[f"{node.name}/required"] = node.respawn, node.required
        found.update((f"{node.name}/remap/{name}", topic) for name, topic in node.remap_args)
    return {(name, repr(value)) for name, value in found.items() if name.strip("/").split("/")[0] in NODES}


def another_value(argument, tmp_path):
    """Something that the argument is not by default."""
    if argument.endswith("_settings") or argument == "robot":
        path = tmp_path / f"{argument}.yaml"
        contents = {"robot": "wheel_base: 0.7", "wheel_settings": "radius_sigma: 0.02"}
        path.write_text(contents.get(argument, "silence: 7.0"))
        return str(path)
    return OTHER_VALUES.get(argument, "another")


WITH_WHEELS = {"motion_prediction": "true"}  # which a dso_node by itself does not have
PASSED_ON = sorted({argument for part in PARTS for argument in declared(part)})
BY_ITSELF = {("playback", "required"), ("playback", "respawn")}  # one follows from the other there, see below


@pytest.mark.parametrize("whole", WHOLES)
def test_every_argument_of_the_parts_is_one_of_the_whole_and_says_the_same(whole):
    given = declared(whole)
    for part in PARTS:
        for argument, (doc, default) in declared(part).items():
            assert argument in given, argument
            assert given[argument][0] == doc
            expected = WITH_WHEELS.get(argument, default)
            if (whole, argument) in BY_ITSELF:
                continue
            assert given[argument][1].lstrip("/") == expected.lstrip("/")  # topics of a bag are absolute


@pytest.mark.parametrize("argument", PASSED_ON)
@pytest.mark.parametrize("whole", WHOLES)
def test_every_argument_reaches_the_nodes(whole, argument, tmp_path):
    if (whole, argument) in BY_ITSELF:
        return
    value = another_value(argument, tmp_path)
    changed = set()
    for part in PARTS:
        if argument in declared(part):
            changed |= state(load(part, f"{argument}:={value}")) - state(load(part))
    assert changed, "the argument does nothing"
    assert state(load(whole, f"{argument}:={value}")) - state(load(whole)) == changed


@pytest.mark.parametrize("whole", WHOLES)
def test_every_parameter_of_the_nodes_has_an_argument(whole):
    arguments = {argument: "another" for argument in PASSED_ON if default_of(whole, argument) == ""}
    config = load(whole, *(f"{argument}:={value}" for argument, value in arguments.items()))
    for node, kinds in NODES.items():
        if node in {each.name for each in config.nodes}:
            assert {field.name for field in fields(kinds[0])} - set(nested(config, node)) == NOT_LAUNCHED[node]


@pytest.mark.parametrize("name", [*PARTS, *WHOLES])
def test_nodes_take_what_is_set_by_default(name):
    config = load(name)
    for node in {each.name for each in config.nodes} & set(NODES):
        values, kinds = nested(config, node), NODES[node]
        if "robot" in values:
            robot_from_values(values.pop("robot"), node, np.eye(4))
        require_known(values, {each: None for kind in kinds for each in default_values(kind)}, node)
        for kind in kinds:
            known = {each: value for each, value in values.items() if each in default_values(kind)}
            merge_settings(kind, [(node, known)], node)


def test_an_argument_counts_more_than_the_file_and_the_file_more_than_the_default(tmp_path):
    settings = tmp_path / "fusion.yaml"
    settings.write_text("{silence: 3.0, odom_frame: odom_of_the_file, publish_tf: off}")
    values = nested(load("playback", f"fusion_settings:={settings}", "odom_frame:=odom_of_mine"), "fusion_node")
    assert (values["silence"], values["odom_frame"], values["publish_tf"]) == (3.0, "odom_of_mine", False)


def test_what_an_earlier_launch_has_set_is_cleared():
    assert set(load("simulation").clear_params) == {f"/{node}/" for node in NODES}


def test_a_window_is_left_to_the_settings_unless_it_is_given(tmp_path):
    settings = tmp_path / "dso.yaml"
    settings.write_text("window: {max_keyframes: 5}")
    given = [f"dso_settings:={settings}"]
    assert nested(load("simulation", *given), "dso_node")["window"] == {"max_keyframes": 5}
    assert nested(load("simulation", *given, "window:=7"), "dso_node")["window"] == {"max_keyframes": 7}


def test_parameters_in_a_launch_file_of_the_users_own_count(tmp_path):
    own = tmp_path / "own.launch"
    own.write_text(
        "<launch><include file='$(find ceiling_dso_ros)/launch/ceiling_odometry.launch'/>"
        "<rosparam ns='dso_node'>window: {max_keyframes: 6}</rosparam>"
        "<rosparam ns='fusion_node'>visual: {tilt_limit_rad: deg(3)}</rosparam>"
        "<param name='fusion_node/silence' value='2'/></launch>"
    )
    config = ROSLaunchConfig()
    XmlLoader().load(str(own), config, argv=[], verbose=False)
    assert nested(config, "dso_node")["window"] == {"max_keyframes": 6}
    assert nested(config, "fusion_node")["silence"] == 2
    assert nested(config, "fusion_node")["visual"]["tilt_limit_rad"] == pytest.approx(0.0523599)


@pytest.mark.parametrize(
    "path", ["/data/drive.bag", "/my data/drive 1.bag", "/it's/drive.bag", '/"a"/b\\c/$x/(1)/d;e&f.bag']
)
def test_paths_of_bags_may_hold_anything(path):
    config = load("playback", f"bag:={path}", f"record:={path}", "play_args:=--loop --start 10")
    arguments = {node.name: shlex.split(node.args) for node in config.nodes}
    assert arguments["player"][-4:] == ["--loop", "--start", "10", path]
    assert arguments["recorder"][:2] == ["--output-name", path]


@pytest.mark.parametrize("planner", ["TrajectoryPlannerROS", "DWAPlannerROS"])
@pytest.mark.parametrize(
    ("arguments", "topic"), [([], "odometry/filtered"), (["odometry:=another/name"], "another/name")]
)
def test_move_base_follows_the_output_to_its_topic(planner, arguments, topic):
    config = load("../cfg/examples/move_base", *arguments)
    assert nested(config, "move_base")[planner]["odom_topic"] == topic
    fusion = next(node for node in config.nodes if node.name == "fusion_node")
    assert [new for old, new in fusion.remap_args if old.lstrip("/") == "odometry/filtered"] == [topic]


def test_move_base_drives_the_simulated_robot():
    config = load("../cfg/examples/move_base_simulated", "camera_size:=424x240")
    simulated = nested(config, "simulation_node")
    assert (simulated["drive"], simulated["camera_size"]) == ("cmd_vel", "424x240")
    assert nested(config, "move_base")["DWAPlannerROS"]["odom_topic"] == "odometry/filtered"
    assert {"simulation_node", "dso_node", "fusion_node", "move_base"} <= {node.name for node in config.nodes}


def test_playback_records_what_the_nodes_are_told_to_publish():
    config = load("playback", "record:=/x.bag", "odometry:=ceiling/odometry", "wheel_odometry:=/robot/odom")
    recorder = next(node for node in config.nodes if node.name == "recorder")
    assert {"/ceiling/odometry", "/robot/odom"} <= set(shlex.split(recorder.args))
    assert "recorder" not in {node.name for node in load("playback").nodes}


@pytest.fixture
def gate(monkeypatch):
    """Makes playback_gate with arguments of playback.launch, for a bag with some topics."""

    def make(*arguments, types=None):
        values = {name: parameter.value for name, parameter in load("playback", *arguments).params.items()}

        def get_param(name, default=None):
            return values.get(f"/playback_gate/{name[1:]}" if name.startswith("~") else f"/{name}", default)

        def contents(path):
            bag = BagContents.__new__(BagContents)
            bag.path, bag.types = path, AllTopics() if types is None else types
            return bag

        monkeypatch.setattr(rospy, "get_param", get_param)
        monkeypatch.setattr(rospy, "resolve_name", lambda name: f"/{name.lstrip('/')}")
        monkeypatch.setattr(playback_gate, "BagContents", contents)
        return playback_gate.PlaybackGate()

    return make


class AllTopics(dict):
    """Types of a bag that has every topic."""

    def __contains__(self, topic):
        return True


@pytest.fixture
def awaited_topics(gate):
    """The topics for which playback_gate waits with arguments of playback.launch."""
    return lambda *arguments: gate(*arguments).awaited


IMAGE, WHEELS = "/camera/up/image_raw", "/joint_states"
BETWEEN_NODES = {"/visual_odometry/status", "/wheel/odometry"}


@pytest.mark.parametrize(
    ("arguments", "topics"),
    [
        ([], {IMAGE, WHEELS, *BETWEEN_NODES}),
        (["joint_states:=/my/joints"], {IMAGE, "/my/joints", *BETWEEN_NODES}),
        (["image:=/my/camera", "image_transport:=compressed"], {"/my/camera/compressed", WHEELS, *BETWEEN_NODES}),
        (["image_transport:=raw"], {IMAGE, WHEELS, *BETWEEN_NODES}),
        (["wheel_input:=ticks", "right_ticks:=/r"], {IMAGE, "/wheel/left/ticks", "/r", *BETWEEN_NODES}),
        (["wheel_input:=odometry", "wheel_odometry:=/robot/odom"], {IMAGE, "/visual_odometry/status", "/robot/odom"}),
        (["record:=/x.bag"], {IMAGE, WHEELS, *BETWEEN_NODES, "/odometry/filtered"}),
        (["record:=/x.bag", "odometry:=ceiling/odometry"], {IMAGE, WHEELS, *BETWEEN_NODES, "/ceiling/odometry"}),
    ],
)
def test_the_bag_begins_when_its_topics_and_those_between_the_nodes_have_subscribers(awaited_topics, arguments, topics):
    assert awaited_topics(*arguments) == topics


def test_the_bag_waits_for_compressed_images_of_a_settings_file_too(awaited_topics, tmp_path):
    settings = tmp_path / "dso.yaml"
    settings.write_text("image_transport: compressed")
    assert f"{IMAGE}/compressed" in awaited_topics(f"dso_settings:={settings}")


OF_OTHERS = {
    "/ceiling/image": "sensor_msgs/msg/Image",
    "/encoders": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
}


@pytest.mark.parametrize(
    ("types", "arguments", "complaint"),
    [
        (OF_OTHERS, [], f"{IMAGE} is not in it; choose with the argument image; it has /ceiling/image"),
        ({}, [], f"{IMAGE} is not in it; choose with the argument image; it has nothing of the kind"),
        ({f"{IMAGE}/compressed": "sensor_msgs/msg/CompressedImage"}, [], "set image_transport:=compressed"),
    ],
)
def test_a_bag_without_the_images_is_not_played(gate, types, arguments, complaint):
    with pytest.raises(InputError, match=re.escape(complaint)):
        gate("bag:=/x.bag", *arguments, types=types)


def test_a_bag_without_the_wheels_is_played_and_that_is_said(gate, monkeypatch):
    said = []
    monkeypatch.setattr(rospy, "logwarn", said.append)
    gate("bag:=/x.bag", "image:=/ceiling/image", types=OF_OTHERS)
    (line,) = said
    assert line.startswith("/x.bag: /joint_states is not in it: no wheels; choose with the argument joint_states")
    assert line.endswith("it has /encoders")


@pytest.mark.parametrize("respawn", ["true", "false"])
def test_playback_ends_with_a_node_that_ends_unless_it_is_started_again(respawn):
    nodes = {node.name: node for node in load("playback", f"respawn:={respawn}", "localization:=true").nodes}
    for name in ("dso_node", "fusion_node", "wheel_odometry_node", "map_node"):
        assert (nodes[name].required, nodes[name].respawn) == (respawn == "false", respawn == "true")
    assert not any(node.required for node in load("ceiling_odometry").nodes)
