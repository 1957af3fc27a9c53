# SPDX-License-Identifier: BSD-3-Clause
"""From the sensor to the output the stamps are the very same integers, whatever they are."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.fusion.config import RobotModel
from ceiling_dso_ros.fusion.estimator import FusionEstimator
from ceiling_dso_ros.io.bag import BagRecording
from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.rolling_file import RollingFile
from ceiling_dso_ros.io.stamps import LATEST_NS, format_stamp, parse_stamp_ns
from ceiling_dso_ros.io.trajectory import Trajectory, read_tum, tum_lines, write_tum
from ceiling_dso_ros.playback.fused_record import FusedRecord
from ceiling_dso_ros.playback.timing_log import TimingLog
from ceiling_dso_ros.playback.visual_run import VisualRun
from ceiling_dso_ros.playback.wheel_playback import WheelPlayback

LATEST_BAG_NS = 2**31 * 10**9 - 1  # rosbags writes seconds as int32
NOWHERE = np.eye(4)
IMAGE, K = np.zeros((64, 64), np.uint8), np.array([[50.0, 0.0, 31.5], [0.0, 50.0, 31.5], [0.0, 0.0, 1.0]])
ROBOT = """
ticks_per_turn: 4096
wheel_radius: [0.1, 0.1]
wheel_base: 0.5
T_base_camera: {xyz: [0, 0, 0], quat_xyzw: [0, 0, 0, 1]}
"""

of_any_time = settings(deadline=None, max_examples=20, database=None)


def stamps(latest_ns):
    """A few, increasing; some are a nanosecond apart."""
    return st.lists(st.integers(1, latest_ns), min_size=2, max_size=8, unique=True).map(sorted)


class StandingOdometry:
    """Makes every image a keyframe."""

    def track(self, _image, stamp_ns, _exposure_ms, _prediction, _right=None):
        keyframe = KeyframeEstimate(stamp_ns, stamp_ns, 0, NOWHERE, (0.0, 0.0), False)
        return OdometryStatus(
            stamp_ns, TrackingState.TRACKING, 0, NOWHERE, None, True, stamp_ns, NOWHERE, keyframes=(keyframe,)
        )


@of_any_time
@given(stamps(LATEST_BAG_NS))
def test_images_from_a_bag_to_the_files_of_a_run(stamps_ns):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with BagWriter(folder / "a.bag") as bag:
            for stamp_ns in stamps_ns:
                bag.camera_info("/camera/up/camera_info", stamp_ns, "camera", (64, 64), K)
                bag.image("/camera/up/image_raw", stamp_ns, "camera", IMAGE)
        run, timing = VisualRun(lambda image: image, StandingOdometry()), TimingLog()
        for frame in BagRecording(folder / "a.bag").frames():
            tracked = run.track(frame.image, frame.stamp_ns, frame.exposure_ms)
            timing.add(tracked.status, tracked.total_ms)
        for file, make in run.trajectories.files().items():
            write_tum(folder / file, make())
            assert read_tum(folder / file).stamps_ns.tolist() == stamps_ns
        timing.write_csv(folder / "timing.csv")
        rows = (folder / "timing.csv").read_text().splitlines()[1:]
        assert [parse_stamp_ns(row.split(",")[0]) for row in rows] == stamps_ns


@of_any_time
@given(stamps(LATEST_BAG_NS))
def test_wheels_from_a_bag_to_the_fused_states_and_their_file(stamps_ns):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with BagWriter(folder / "a.bag") as bag:
            bag.camera_info("/camera/up/camera_info", stamps_ns[0], "camera", (64, 64), K)
            bag.image("/camera/up/image_raw", stamps_ns[0], "camera", IMAGE)
            for stamp_ns in stamps_ns:
                bag.joint_state("/joint_states", stamp_ns, ("left_wheel", "right_wheel"), (0.0, 0.0))
        (folder / "a.robot.yaml").write_text(ROBOT)
        wheels = BagRecording(folder / "a.bag").wheels
        assert [stamp_ns for stamp_ns, _, _ in wheels] == stamps_ns
        estimator, record = FusionEstimator(RobotModel(NOWHERE, 0.5, (0.1, 0.1))), FusedRecord()
        states = list(WheelPlayback(wheels, estimator).until())
        assert [state.stamp_ns for state in states] == stamps_ns[1:]
        for state in states:
            record.add(state, np.zeros(3))
        write_tum(folder / "fused.tum", record.fused())
        assert read_tum(folder / "fused.tum").stamps_ns.tolist() == stamps_ns[1:]


@of_any_time
@given(stamps(LATEST_NS))
def test_a_file_that_grows_with_the_run(stamps_ns):
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "a.tum"
        file = RollingFile(path, 10**6)
        for stamp_ns in stamps_ns:
            file.append(tum_lines(Trajectory.from_matrices([stamp_ns], [NOWHERE])))
        file.flush()
        written = path.read_bytes()
        assert read_tum(path).stamps_ns.tolist() == stamps_ns
        write_tum(path, read_tum(path))
        assert path.read_bytes() == written


@of_any_time
@given(st.integers(0, LATEST_NS))
def test_text_and_back(stamp_ns):
    assert parse_stamp_ns(format_stamp(stamp_ns)) == stamp_ns
