# SPDX-License-Identifier: BSD-3-Clause
"""Parameters given in a launch file reach the nodes, from devel and install space, and all of them are shown."""

import shlex
import signal
import subprocess
import xmlrpc.client
from dataclasses import fields
from pathlib import Path

import pytest
import yaml
from waiting import wait_until

pytest.importorskip("ceiling_dso_ros.cfg", reason="needs ROS and the built workspace")

from ceiling_dso_ros.dso import OdometryConfig
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.ros.node_parameters import DsoParameters, FusionParameters, WheelParameters

WORKSPACE = Path(__file__).parents[2] / ".ws"
PATIENCE_S = 180.0
NODES = {
    "dso_node": (DsoParameters, OdometryConfig),
    "wheel_odometry_node": (WheelParameters,),
    "fusion_node": (FusionParameters, FusionConfig),
}
NAMES = {node: {field.name for kind in kinds for field in fields(kind)} for node, kinds in NODES.items()}
pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(not (WORKSPACE / "build").is_dir(), reason="needs the workspace that scripts/bootstrap makes"),
]

LAUNCH = """<launch>
  <include file="$(find ceiling_dso_ros)/launch/ceiling_odometry.launch">
    <arg name="dso_settings" value="$(dirname)/my settings.yaml"/>
    <arg name="trajectory_dir" value="$(dirname)/it's here"/>
    <arg name="image_size" value="424x240"/>
  </include>
  <rosparam ns="dso_node">
    window: {max_keyframes: 6}
    tracking: {cutoff: 1e1}
  </rosparam>
  <rosparam ns="fusion_node">
    visual: {tilt_limit_rad: deg(3)}
    wheels: {radius_sigma: 0}
    publish_tf: off
  </rosparam>
  <param name="fusion_node/silence" value="2"/>
</launch>"""
SETTINGS = "window: {active_points: 800}\nvo_frame: 7\nkeep_trajectory: no\n"


@pytest.fixture(params=["devel", "install"])
def space(request, in_space):
    if request.param == "install":
        command = f"catkin_make -C {shlex.quote(str(WORKSPACE))} install"
        subprocess.run(in_space("devel", shlex.split(command)), check=True, timeout=PATIENCE_S, capture_output=True)
    return request.param


def test_parameters_of_a_launch_file(space, in_space, environment, master, tmp_path):
    folder = tmp_path / "a folder"
    folder.mkdir()
    (folder / "own.launch").write_text(LAUNCH)
    (folder / "my settings.yaml").write_text(SETTINGS)
    master.setParam("/test", "/dso_node/window/min_keyframes", 4)
    master.setParam("/test", "/dso_node/of_an_older_version", True)  # this master has been in use before
    log = (tmp_path / "roslaunch.log").open("w")
    launch = in_space(space, ["roslaunch", str(folder / "own.launch")])
    process = subprocess.Popen(launch, env=environment, stdout=log, stderr=log, start_new_session=True)
    try:
        # Not until the nodes are ready: in a new install space dso_node has its kernels to compile.
        wait_until(lambda: all(shown(master, node) >= names for node, names in NAMES.items()), process=process)
        wait_until(lambda: master.lookupService("/test", "/fusion_node/save_trajectory")[0] == 1, process=process)
        dump = subprocess.run(
            in_space(space, ["rosparam", "dump"]), env=environment, capture_output=True, text=True, timeout=PATIENCE_S
        )
        executables = {node: executable_of(master, node) for node in NODES}
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    assert {path.parents[2].name for path in executables.values()} == {space}

    parameters = yaml.safe_load(dump.stdout)
    for node, names in NAMES.items():
        assert set(parameters[node]) - {"robot"} == names, node
    dso, fusion = parameters["dso_node"], parameters["fusion_node"]
    # of the launch file, of the file that it names, of its arguments, and the defaults
    assert dso["window"] == {**dso["window"], "max_keyframes": 6, "active_points": 800, "min_keyframes": 5}
    assert (dso["tracking"]["cutoff"], dso["vo_frame"], dso["keep_trajectory"]) == (10.0, "7", False)
    assert (dso["image_size"], dso["trajectory_dir"]) == ("424x240", f"{folder}/it's here")
    assert fusion["visual"]["tilt_limit_rad"] == pytest.approx(0.0523599)
    assert (fusion["wheels"]["radius_sigma"], fusion["silence"], fusion["publish_tf"]) == (0.0, 2.0, False)
    assert fusion["robot"] == parameters["wheel_odometry_node"]["robot"]
    assert set(fusion["robot"]) >= {"ticks_per_turn", "wheel_radius", "wheel_base", "camera_time_offset"}
    assert (folder / "it's here" / "fused.tum").is_file()


def shown(master, node):
    """Names of the node's parameters on the server."""
    _, _, parameters = master.getParam("/test", f"/{node}")
    return set(parameters) if isinstance(parameters, dict) else set()


def executable_of(master, node):
    """The file that a running node was started from."""
    pid = xmlrpc.client.ServerProxy(master.lookupNode("/test", f"/{node}")[2]).getPid("/test")[2]
    return Path(Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[1].decode())
