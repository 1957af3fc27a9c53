# SPDX-License-Identifier: BSD-3-Clause
"""The fusion on the shared recording, with the trajectory of the C++ reference as its visual odometry."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus, TrackingState
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.config import FusionConfig, RobotModel
from ceiling_dso_ros.fusion.estimator import FusionEstimator

DATA = Path(os.environ.get("CEILING_DSO_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
FOLDER = DATA / "ceiling_loops"

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the recording is missing: {FOLDER}")


def matrices(rows):
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
    T[:, :3, 3] = rows[:, 1:4]
    return T


def statuses(every=5):
    """Every fifth frame as a keyframe."""
    rows = np.loadtxt(FOLDER / "reference_final.tum")
    window, result = [], []
    for index, (stamp_ns, T) in enumerate(zip(map(nanoseconds, rows[:, 0]), matrices(rows))):
        is_keyframe = index == 0 or index % every == 1
        if is_keyframe:
            key = window[-1].keyframe_id + 1 if window else 0
            window = [*window, KeyframeEstimate(key, stamp_ns, 0, T, (0.0, 0.0), leaves=False)][-7:]
        if index == 0:
            continue  # the odometry tells of its first keyframe when it has initialised
        T_relative = np.linalg.inv(window[-1].T_world_camera) @ T
        shown = tuple(window) if is_keyframe else ()
        key = window[-1].keyframe_id
        result.append(
            OdometryStatus(
                stamp_ns, TrackingState.TRACKING, 0, T, np.eye(6) * 1e-8, is_keyframe, key, T_relative, shown
            )
        )
    return result


@pytest.fixture(scope="module")
def estimator():
    values = yaml.safe_load((FOLDER / "robot.yaml").read_text())
    mount = values["T_base_camera"]
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(mount["quat_xyzw"]).as_matrix()
    T[:3, 3] = mount["xyz"]
    robot = RobotModel(T, values["wheel_base"], tuple(values["wheel_radius"]), values["ticks_per_turn"])
    result = FusionEstimator(robot, FusionConfig(), keep_history=True)
    ticks = np.loadtxt(FOLDER / "encoders.csv", delimiter=",", skiprows=1)
    events = [(nanoseconds(row[0]), 0, row) for row in ticks] + [(status.stamp_ns, 1, status) for status in statuses()]
    for stamp_ns, is_camera, data in sorted(events, key=lambda event: event[:2]):
        if is_camera:
            result.add_keyframes(data)
            result.add_frame(data)
        else:
            result.add_wheel_ticks(stamp_ns, int(data[1]), int(data[2]))
    return result


@pytest.fixture(scope="module")
def truth():
    rows = np.loadtxt(FOLDER / "groundtruth_base.tum")
    return rows[:, 0], rows[:, 1:3]


def test_the_smoothed_path_has_the_true_shape(estimator, truth):
    nodes = estimator.smoothed()
    stamps, positions = truth
    true = np.column_stack([np.interp([seconds(n.stamp_ns) for n in nodes], stamps, column) for column in positions.T])
    found = np.array([node.pose[:2] for node in nodes])
    a, b = true - true.mean(axis=0), found - found.mean(axis=0)
    turn = np.arctan2((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum(), (a * b).sum())
    b = b @ planar.rotation(turn).T
    error = a - (a * b).sum() / (b * b).sum() * b  # Sim(2)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.01


def test_the_scale_is_what_the_nominal_wheels_imply(estimator, truth):
    """The wheels say how long the way was, the truth how long it is, and the camera's own scale is known from there."""
    stamps, positions = truth
    ticks = np.loadtxt(FOLDER / "encoders.csv", delimiter=",", skiprows=1)
    rows = np.loadtxt(FOLDER / "reference_final.tum")
    camera = np.loadtxt(FOLDER / "groundtruth.tum")
    seen = rows[1:, 1:4]
    true = np.column_stack([np.interp(rows[1:, 0], camera[:, 0], column) for column in camera[:, 1:4].T])
    units = np.sqrt(((seen - seen.mean(axis=0)) ** 2).sum() / ((true - true.mean(axis=0)) ** 2).sum())
    wheels_m = np.abs(np.diff(ticks[:, 1:].mean(axis=1)) * 2 * np.pi * 0.098 / 4096).sum()
    at_ticks = np.column_stack([np.interp(ticks[:, 0], stamps, column) for column in positions.T])
    way_m = np.hypot(*np.diff(at_ticks, axis=0).T).sum()
    implied = wheels_m / way_m / units
    assert estimator.scale.converged
    assert estimator.scale.value == pytest.approx(implied, rel=0.003)


def test_it_says_how_far_the_wheels_can_be_trusted(estimator):
    """The radii are 1.3 % off, which is 2.6 sigma of what is believed of them."""
    path_m = json.loads((FOLDER / "reference.json").read_text())["path_m"]
    assert path_m > 20
    assert 0.005 <= estimator.scale.sigma < 0.01
    assert estimator.slips == []
