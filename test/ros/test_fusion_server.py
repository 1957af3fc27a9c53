# SPDX-License-Identifier: BSD-3-Clause
"""The server of fusion_node, without a master: what services, disks and errors may not do to the output."""

import threading

import numpy as np
import pytest

pytest.importorskip("ceiling_dso_ros.msg", reason="needs ROS and the built workspace")
pytestmark = pytest.mark.ros

import rospy  # noqa: E402
from geometry_msgs.msg import PoseStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from straight_drive import Drive  # noqa: E402

from ceiling_dso_ros.io.ros_messages import planar_pose  # noqa: E402
from ceiling_dso_ros.io.trajectory import read_tum  # noqa: E402
from ceiling_dso_ros.ros import diagnostics, run_clock, trajectory_keeper  # noqa: E402
from ceiling_dso_ros.ros.conversions import pose_from_matrix, ros_time  # noqa: E402
from ceiling_dso_ros.ros.fusion_server import FusionServer  # noqa: E402
from ceiling_dso_ros.srv import SetPoseRequest  # noqa: E402

ROBOT = {
    "ticks_per_turn": 4096.0,
    "wheel_radius": [0.1, 0.1],
    "wheel_base": 0.5,
    "T_base_camera": {"xyz": [0.0, 0.0, 0.5], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
}
OUTPUT = "odometry/filtered"
WIDTH, HEIGHT = 200, 160


class FusionDrive:
    """A fusion_node that hears a drive."""

    def __init__(self, world):
        self.world, self.drive, self.server = world, Drive(), FusionServer()
        self._wheels = self.drive.wheels(self.drive.image_ns(10**6))
        self._next = next(self._wheels)
        self._image = self.heard = 0  # images and wheel samples so far

    @property
    def outputs(self):
        return self.world.sent.get(OUTPUT, 0)

    def go_on(self, images):
        """Hear further images, and the wheels up to each of them."""
        for _ in range(images):
            while self._next[0] <= self.drive.image_ns(self._image):
                self.hear_wheels()
            self.world.callbacks["visual_odometry/status"](self.drive.image(self._image))
            self._image += 1

    def hear_wheels(self):
        stamp_ns, (x, _, _) = self._next
        self._next = next(self._wheels)
        message = Odometry(header=Header(stamp=ros_time(stamp_ns), frame_id="odom"))
        T = np.eye(4)
        T[0, 3] = x
        message.pose.pose = pose_from_matrix(T)
        self.heard += 1
        self.world.callbacks["wheel/odometry"](message)


@pytest.fixture
def fusion(rosless):
    return FusionDrive(rosless(robot=ROBOT))


def test_output_goes_on_while_trajectories_are_saved(fusion, tmp_path, monkeypatch):
    """However long that takes; here it waits for the output."""
    compute, answer = trajectory_keeper.write_all_apart, []
    begins, ends = threading.Event(), threading.Event()

    def slow(*folders):
        begins.set()
        ends.wait()
        return compute(*folders)

    monkeypatch.setattr(trajectory_keeper, "write_all_apart", slow)
    fusion.go_on(150)
    saving = threading.Thread(
        target=lambda: answer.append(fusion.world.call("~save_trajectory", directory=str(tmp_path / "out")))
    )
    saving.start()
    begins.wait()
    before = fusion.outputs
    fusion.go_on(150)
    went_on = fusion.outputs
    ends.set()
    saving.join()
    assert went_on == fusion.heard - 1 > before + 200
    assert answer[0].success, answer[0].message
    fused, smoothed = (read_tum(tmp_path / "out" / f"{name}.tum") for name in ("fused", "fused_smoothed"))
    assert len(fused) == before
    assert len(smoothed) == 30  # a keyframe every five images
    assert f"fused.tum ({before} poses)" in answer[0].message


def test_a_reset_begins_new_trajectories(fusion, tmp_path):
    fusion.go_on(150)
    assert fusion.world.call("~reset").success
    before = fusion.heard
    fusion.go_on(30)
    assert fusion.world.call("~save_trajectory", directory=str(tmp_path / "out")).success
    assert len(read_tum(tmp_path / "out" / "fused.tum")) == fusion.heard - before - 1


def test_what_the_node_remembers_does_not_grow(fusion):
    """All that was kept is on the disk."""
    fusion.go_on(300)
    server = fusion.server
    assert len(server._estimator._backend._graph.history) == 0
    server._keeper.spool.flush()
    kept = server._keeper.spool
    assert len(kept._outputs) == 0
    assert all(file._pending == [] for file in kept._files.values())


def test_the_end_leaves_all_trajectories_and_nothing_else(rosless, ros_home, tmp_path, capsys):
    fusion = FusionDrive(rosless(robot=ROBOT, trajectory_dir=str(tmp_path / "out")))
    fusion.go_on(60)
    fusion.server._keeper.end()
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "fused.tum",
        "fused_smoothed.tum",
        "wheel.tum",
    ]
    assert not ros_home.exists()
    assert "wheel.tum (" in capsys.readouterr().out


def test_the_end_without_a_folder_leaves_nothing(fusion, ros_home):
    fusion.go_on(60)
    assert len(list((ros_home / "ceiling_dso_ros").iterdir())) == 1
    fusion.server._keeper.end()
    assert list((ros_home / "ceiling_dso_ros").iterdir()) == []


def test_answers_of_services_are_one_line_of_bounded_length(fusion):
    fusion.go_on(3)
    pose = PoseStamped(header=Header(frame_id="a\n" + "x" * 5000))
    answer = fusion.world.services["~set_pose"](SetPoseRequest(pose))
    assert not answer.success
    assert answer.message.isprintable()
    assert answer.message.endswith(", not in odom")


@pytest.mark.parametrize(
    ("directory", "complaint"),
    [
        ("", "directory is empty: name the folder to write to"),
        ("~no-such-user/out", "~no-such-user/out: this home is unknown: "),
        ("/tmp/a\0b", "'/tmp/a\\x00b': no file has a NUL in its name"),
        ("/tmp/\ud800", "'/tmp/\\ud800': no name of a file: "),
        ("/dev/null", "/dev/null: cannot write there: "),
    ],
)
def test_trajectories_are_not_saved_where_there_is_no_folder(fusion, directory, complaint):
    fusion.go_on(3)
    answer = fusion.world.call("~save_trajectory", directory=directory)
    assert not answer.success
    assert answer.message.startswith(complaint)
    assert answer.message.isprintable()


@pytest.mark.parametrize("below", [".", "new"])
def test_nothing_is_saved_into_the_folder_where_results_are_kept(fusion, tmp_path, below):
    """It would replace a file to which the node goes on writing."""
    fusion.go_on(30)
    spool = fusion.server._keeper.spool
    answer = fusion.world.call("~save_trajectory", directory=str(spool.path / below))
    assert not answer.success
    assert answer.message.endswith(f"a node keeps its results in {spool.path}; choose a folder outside of it")
    fusion.go_on(30)
    assert fusion.world.call("~save_trajectory", directory=str(tmp_path / "out")).success
    assert len(read_tum(tmp_path / "out" / "fused.tum")) == fusion.outputs


def test_what_was_saved_is_said_in_one_line(fusion, tmp_path):
    fusion.go_on(30)
    answer = fusion.world.call("~save_trajectory", directory=str(tmp_path / "two\nlines"))
    assert answer.success
    assert answer.message.startswith(f"{tmp_path / 'two lines'}: wheel.tum (")
    assert answer.message.isprintable()
    assert (tmp_path / "two\nlines" / "fused.tum").exists()


@pytest.mark.parametrize(("x_m", "is_taken"), [(1e8, False), (-5.1e7, False), (5e7, True), (-5e7, True)])
def test_a_pose_is_set_only_to_where_the_robot_can_drive_on(fusion, x_m, is_taken):
    """What is published from then on can be read by whoever reads poses as this package does."""
    fusion.go_on(30)
    pose = PoseStamped()
    pose.pose.position.x, pose.pose.orientation.w = x_m, 1.0
    answer = fusion.world.services["~set_pose"](SetPoseRequest(pose))
    assert answer.success == is_taken
    assert is_taken or "the pose has a number beyond 5e+07" in answer.message
    fusion.go_on(30)
    x, _, _ = planar_pose(fusion.world.newest[OUTPUT].pose.pose)
    assert abs(x - (x_m if is_taken else 0.0)) < 10.0


def test_a_home_that_cannot_be_written_stops_nothing(rosless, ros_home, tmp_path):
    ros_home.touch()
    fusion = FusionDrive(rosless(robot=ROBOT))
    fusion.go_on(60)
    assert fusion.outputs == fusion.heard - 1
    reason = f"{ros_home / 'ceiling_dso_ros'}: trajectories cannot be kept: Not a directory"
    status = fusion.world.diagnostics()
    assert reason in status.message
    assert status.level >= diagnostics.WARN
    answer = fusion.world.call("~save_trajectory", directory=str(tmp_path / "out"))
    assert not answer.success
    assert reason in answer.message
    fusion.server._keeper.end()


def test_without_keep_trajectory_there_is_nothing_to_save(rosless, ros_home, tmp_path):
    fusion = FusionDrive(rosless(robot=ROBOT, keep_trajectory=False))
    fusion.go_on(60)
    answer = fusion.world.call("~save_trajectory", directory=str(tmp_path / "out"))
    assert (answer.success, answer.message) == (False, "/robot/node: no trajectories: keep_trajectory is false")
    assert not ros_home.exists()


def test_one_file_that_cannot_be_written_is_named_with_its_reason(fusion, tmp_path):
    fusion.go_on(60)
    (tmp_path / "out" / "fused.tum").mkdir(parents=True)
    answer = fusion.world.call("~save_trajectory", directory=str(tmp_path / "out"))
    assert not answer.success
    assert "fused.tum: cannot write the trajectory: Is a directory; written: wheel.tum (98 poses)" in answer.message
    assert len(read_tum(tmp_path / "out" / "fused_smoothed.tum")) > 5


def test_results_that_the_disk_does_not_take_are_warned_of_once_and_counted(fusion, monkeypatch):
    monkeypatch.setattr("ceiling_dso_ros.io.rolling_file.MOST_PENDING", 50)
    keeper = fusion.server._keeper
    for _ in range(2):
        for _ in range(3):
            keeper.spool._files["motions.bin"].append(bytes(40))
        keeper._flush()
        assert "the disk did not answer for too long" in fusion.world.diagnostics().message
    assert len([line for line in fusion.world.logged if "the disk did not answer for too long" in line]) == 1
    values = {pair.key: pair.value for pair in fusion.world.diagnostics().values}
    assert values["results not kept"] == "4"


def test_a_run_that_was_killed_is_pointed_to(rosless, ros_home):
    left = ros_home / "ceiling_dso_ros" / "robot-node.20260101-000000.12345.spool"
    left.mkdir(parents=True)
    (left / "fused.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    world = rosless(robot=ROBOT)
    FusionServer()
    assert [line for line in world.logged if f"python3 -m ceiling_dso_ros collect {left} --out" in line]


def test_an_error_with_one_message_concerns_that_message_only(fusion, monkeypatch):
    """rospy logs it; nothing stays locked, and the next message is taken as any other."""
    fusion.go_on(60)
    with monkeypatch.context() as broken:
        broken.setattr(fusion.server._publisher, "publish", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            fusion.hear_wheels()
    fusion.go_on(60)
    assert fusion.outputs == fusion.heard - 2
    assert fusion.world.newest["fusion/status"].state != 0


def closed(*_):
    raise rospy.ROSException("publish() to a closed topic")


def test_a_wheel_sample_at_the_moment_of_the_end_is_no_error(fusion, monkeypatch):
    fusion.go_on(10)
    monkeypatch.setattr(fusion.server._publisher, "publish", closed)
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: True)  # before is_shutdown, which is not yet
    fusion.hear_wheels()
    assert not rospy.is_shutdown()


def test_a_wheel_sample_an_hour_ahead_costs_nothing_while_time_is_simulated(rosless, monkeypatch):
    monkeypatch.setattr(run_clock, "time_is_simulated", lambda: True)
    fusion = FusionDrive(rosless(robot=ROBOT))
    fusion.go_on(60)
    wrong = Odometry(header=Header(stamp=ros_time(fusion.drive.image_ns(60) + 3600 * 10**9), frame_id="odom"))
    wrong.pose.pose.orientation.w = 1.0
    x_m, outputs = fusion.world.newest[OUTPUT].pose.pose.position.x, fusion.outputs
    fusion.world.callbacks["wheel/odometry"](wrong)
    assert fusion.outputs == outputs
    assert "far from that of the last one, and alone" in fusion.world.diagnostics().message
    fusion.go_on(60)
    assert fusion.world.newest[OUTPUT].pose.pose.position.x > x_m > 0.0
    assert fusion.world.newest["fusion/status"].resets == 0


def test_a_topic_that_is_closed_without_an_end_is_an_error(fusion, monkeypatch):
    fusion.go_on(10)
    monkeypatch.setattr(fusion.server._publisher, "publish", closed)
    with pytest.raises(rospy.ROSException, match="closed topic"):
        fusion.hear_wheels()
