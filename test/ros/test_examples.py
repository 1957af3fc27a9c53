# SPDX-License-Identifier: BSD-3-Clause
"""The examples of cfg/examples as they are, with stand-ins for the nodes of other packages.

Neither robot_localization nor move_base is in Debian. The stand-in reads the parameters that the real node reads, takes
the odometry under the topic given there and publishes what the real one publishes; it turns the wheels, too.
"""

import json
import signal
import subprocess
from collections import defaultdict
from pathlib import Path

import pytest
import yaml
from waiting import wait_until

pytest.importorskip("ceiling_dso_ros.cfg", reason="needs ROS and the built workspace")

from ceiling_dso_ros.ros.node_parameters import FusionParameters

CHECKOUT = Path(__file__).parents[2]
EXAMPLES = CHECKOUT / "cfg" / "examples"
STAND_IN = Path(__file__).with_name("navigation_stand_in.py")
EXECUTABLES = {"robot_localization": "ekf_localization_node", "move_base": "move_base"}
SHARED = {"/tf", "/diagnostics", "/rosout", "/rosout_agg"}  # topics of which every node publishes its part
PATIENCE_S = 180.0
pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(not (CHECKOUT / ".ws" / "devel").is_dir(), reason="needs the workspace of scripts/bootstrap"),
]


def make_package(folder, name):
    """A package of that name with the stand-in as its node."""
    package = folder / name
    package.mkdir(parents=True)
    (package / "package.xml").write_text(
        f"<package format='2'><name>{name}</name><version>0.0.0</version><description>stand-in</description>"
        "<maintainer email='nobody@example.com'>nobody</maintainer><license>BSD</license></package>"
    )
    executable = package / EXECUTABLES[name]
    executable.write_text(f"#!{CHECKOUT}/.venv/bin/python\n{STAND_IN.read_text()}")
    executable.chmod(0o755)


@pytest.fixture
def run_example(in_space, environment, master, tmp_path):
    """Starts an example; returns what the stand-in has found and {topic: publishers}."""

    def run(name, *arguments):
        make_package(tmp_path / "packages", name)
        found = tmp_path / "found.json"
        log = (tmp_path / "roslaunch.log").open("w")
        roslaunch = ["roslaunch", str(EXAMPLES / f"{name}.launch"), *arguments]
        path = ["env", f"STAND_IN_RESULT={found}", "bash", "-c"]
        command = f'ROS_PACKAGE_PATH={tmp_path / "packages"}:$ROS_PACKAGE_PATH exec "$@"'
        process = subprocess.Popen(
            in_space("devel", [*path, command, "roslaunch", *roslaunch]),
            env=environment, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
        try:
            wait_until(found.is_file, process=process)
            _, _, (publishers, _, _) = master.getSystemState("/test")
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE_S)
        return json.loads(found.read_text()), dict(publishers)

    return run


def assert_nothing_twice(found, publishers):
    """Every topic is published by one node, and every frame has one parent."""
    assert {topic: nodes for topic, nodes in publishers.items() if len(nodes) > 1 and topic not in SHARED} == {}
    parents = defaultdict(set)
    for node, parent, child in found["transforms"]:
        parents[child].add((parent, node))
    assert {child: each for child, each in parents.items() if len(each) > 1} == {}


@pytest.mark.parametrize("odometry", ["ceiling/odometry", "another/name"])
def test_robot_localization_hears_the_ceiling_and_not_itself(run_example, odometry):
    arguments = [] if odometry == "ceiling/odometry" else [f"odometry:={odometry}"]
    found, publishers = run_example("robot_localization", *arguments)
    assert publishers[f"/{odometry}"] == ["/fusion_node"]
    assert publishers["/odometry/filtered"] == ["/ekf_localization"]
    assert found["odometry"] == [["odom0", "/fusion_node", "odom", "base_link"]]
    assert ["/ekf_localization", "odom", "base_link"] in found["transforms"]
    assert_nothing_twice(found, publishers)


@pytest.mark.parametrize("odometry", ["odometry/filtered", "another/name"])
def test_move_base_hears_the_fusion(run_example, odometry):
    arguments = [] if odometry == "odometry/filtered" else [f"odometry:={odometry}"]
    found, publishers = run_example("move_base", *arguments)
    assert publishers[f"/{odometry}"] == ["/fusion_node"]
    topics = ("DWAPlannerROS/odom_topic", "TrajectoryPlannerROS/odom_topic")
    assert found["odometry"] == [[topic, "/fusion_node", "odom", "base_link"] for topic in topics]
    assert found["transforms"] == [["/fusion_node", "odom", "base_link"]]
    assert_nothing_twice(found, publishers)


def test_frames_are_those_of_the_fusion():
    own = FusionParameters()
    ekf = yaml.safe_load((EXAMPLES / "robot_localization.yaml").read_text())
    assert (ekf["odom_frame"], ekf["world_frame"], ekf["base_link_frame"]) == (
        own.odom_frame,
        own.odom_frame,
        own.base_frame,
    )
    assert [len(ekf[f"{source}_config"]) for source in ("odom0", "imu0")] == [15, 15]
    move_base = yaml.safe_load((EXAMPLES / "move_base.yaml").read_text())
    assert move_base["local_costmap"]["global_frame"] == own.odom_frame
    assert {move_base[each]["robot_base_frame"] for each in ("local_costmap", "global_costmap")} == {own.base_frame}


def test_the_ekf_is_faster_than_the_wheels_of_the_simulated_robot():
    from ceiling_dso_ros.simulation.sensors.encoders import WHEEL_HZ

    assert yaml.safe_load((EXAMPLES / "robot_localization.yaml").read_text())["frequency"] > WHEEL_HZ
