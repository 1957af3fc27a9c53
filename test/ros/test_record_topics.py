# SPDX-License-Identifier: BSD-3-Clause
"""`record` with topics of ROS, on a master of its own."""

import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")

DRIVERS = Path(__file__).parents[1] / "drivers"
sys.path.insert(0, str(DRIVERS))

from fake_bench import STAND_IN, FakeBench  # noqa: E402
from waiting import PATIENCE_S, wait_until  # noqa: E402

from ceiling_dso_ros.io.bag_reader import read_messages  # noqa: E402
from ceiling_dso_ros.io.opening import open_recording  # noqa: E402

WORKSPACE = Path(__file__).parents[2] / ".ws"
pytestmark = [
    pytest.mark.ros,
    pytest.mark.long,
    pytest.mark.skipif(not (WORKSPACE / "build").is_dir(), reason="needs the workspace that scripts/bootstrap makes"),
]
JOINTS = "{header: auto, name: [left_wheel_joint, right_wheel_joint], position: [0.5, 0.25], velocity: [], effort: []}"
OWN = "{header: auto, exposure_ms: 5.0}"


@pytest.fixture
def bench(environment, tmp_path):
    bench = FakeBench(tmp_path / "bench")
    bench.plug_in()
    environment["FAKE_REALSENSE"] = str(bench.folder)
    return bench


def command(in_space, bag, *options):
    words = [sys.executable, "-m", "ceiling_dso_ros", "record", "--out", str(bag), "--size", "424x240", *options]
    shell = f"PYTHONPATH={shlex.quote(str(STAND_IN))}:$PYTHONPATH exec {shlex.join(words)}"
    return in_space("devel", ["bash", "-c", shell])


def test_topics_of_any_type_are_recorded_with_the_camera(bench, in_space, environment, master, tmp_path):
    bag = tmp_path / "drive.bag"
    publishers = [
        subprocess.Popen(in_space("devel", ["rostopic", "pub", "-r", "20", topic, kind, content]), env=environment)
        for topic, kind, content in (
            ("/joint_states", "sensor_msgs/JointState", JOINTS),
            ("/of/this/package", "ceiling_dso_ros/Exposure", OWN),
        )
    ]
    try:
        wait_until(lambda: len(master.getPublishedTopics("/test", "")[2]) >= 2)
        record = command(in_space, bag, "--topic", "/joint_states", "--topic", "/of/this/package", "--duration", "5")
        result = subprocess.run(record, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    finally:
        for publisher in publishers:
            publisher.send_signal(signal.SIGINT)
            publisher.wait(PATIENCE_S)
    assert result.returncode == 0, result.stderr
    assert len(list(open_recording(bag).images())) > 50
    joints = [raw.content() for raw in read_messages(bag, ["/joint_states"])]
    assert len(joints) > 40
    assert {tuple(each.position) for each in joints} == {(0.5, 0.25)}
    assert {raw.content().exposure_ms for raw in read_messages(bag, ["/of/this/package"])} == {5.0}
    assert f"{len(joints)} messages of /joint_states" in result.stdout
    info = subprocess.run(
        in_space("devel", ["rosbag", "info", str(bag)]), env=environment, capture_output=True, text=True
    )
    assert "sensor_msgs/JointState" in info.stdout  # ROS's own tool reads it, too


def test_without_a_master_one_line_says_so(bench, in_space, environment, tmp_path):
    bag = tmp_path / "drive.bag"
    record = command(in_space, bag, "--topic", "/joint_states")
    result = subprocess.run(record, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert result.returncode == 2
    assert result.stderr.splitlines()[-1] == (
        "error: --topic: no ROS master answers; start roscore, or set ROS_MASTER_URI"
    )
    assert not bag.exists()
