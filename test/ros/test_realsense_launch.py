# SPDX-License-Identifier: BSD-3-Clause
"""realsense.launch, and ceiling_odometry.launch with its choice of a camera: nothing is started."""

from dataclasses import fields
from pathlib import Path

import pytest

pytest.importorskip("ceiling_dso_ros.cfg", reason="needs ROS and the built workspace")

from roslaunch.arg_dump import get_args
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader

from ceiling_dso_ros.cfg import RealsenseConfig
from ceiling_dso_ros.drivers.settings import CameraSettings
from ceiling_dso_ros.ros.node_parameters import RealsenseParameters, camera_settings

pytestmark = pytest.mark.ros

LAUNCH = Path(__file__).parents[2] / "launch"
PARAMETERS = {field.name for field in fields(RealsenseParameters)}


def load(name, *arguments):
    config = ROSLaunchConfig()
    XmlLoader().load(str(LAUNCH / f"{name}.launch"), config, argv=list(arguments), verbose=False)
    return config


def declared(name):
    """{argument: (doc, default)} of a launch file."""
    return get_args([str(LAUNCH / f"{name}.launch")])


def parameters(config):
    prefix = "/realsense_node/"
    return {name[len(prefix) :]: each.value for name, each in config.params.items() if name.startswith(prefix)}


def topics(config):
    (node,) = (node for node in config.nodes if node.name == "dso_node")
    return dict(node.remap_args)


def test_every_parameter_of_the_node_has_an_argument():
    assert parameters(load("realsense")) == {}
    assert set(parameters(load("realsense", *(f"{name}:=7" for name in PARAMETERS)))) == PARAMETERS


def test_a_serial_number_is_a_text():
    assert parameters(load("realsense", "serial_no:=046322250613"))["serial_no"] == "046322250613"


def test_ceiling_odometry_takes_all_arguments_of_realsense_and_says_the_same():
    part, whole = declared("realsense"), declared("ceiling_odometry")
    assert {name: whole.get(name) for name in part} == part


@pytest.mark.parametrize("argument", sorted(PARAMETERS))
def test_with_a_realsense_every_argument_reaches_its_driver(argument):
    config = load("ceiling_odometry", "camera:=realsense", f"{argument}:=7")
    assert str(parameters(config)[argument]) == "7"


def test_a_realsense_is_started_only_if_it_is_asked_for():
    def started(*arguments):
        return "realsense_node" in {node.name for node in load("ceiling_odometry", *arguments).nodes}

    assert [started(), started("camera:=realsense"), started("camera:=realsense_ros")] == [False, True, False]


def test_the_topics_of_intels_driver():
    assert topics(load("ceiling_odometry", "camera:=realsense_ros")) == {
        "image": "camera/infra1/image_rect_raw",
        "camera_info": "camera/infra1/camera_info",
        "exposure": "camera/up/exposure",
        "metadata": "camera/infra1/metadata",
        "right/image": "camera/infra2/image_rect_raw",
        "right/camera_info": "camera/infra2/camera_info",
    }
    assert topics(load("ceiling_odometry", "camera:=realsense"))["image"] == "camera/up/image_raw"
    given = load("ceiling_odometry", "camera:=realsense_ros", "image:=up_camera/infra2/image_rect_raw")
    assert topics(given)["image"] == "up_camera/infra2/image_rect_raw"


def test_defaults_and_ranges_are_those_of_the_driver():
    assert camera_settings(RealsenseParameters()) == CameraSettings()
    RealsenseParameters().check()
    assert set(RealsenseConfig.defaults) - {"groups"} <= PARAMETERS
