# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.playback.fused_record import planar_trajectory
from ceiling_dso_ros.playback.mapping import DriveInMap
from ceiling_dso_ros.slam.localiser import Localisation

ODOM = [np.array([0.1 * i, 0.0, 0.0]) for i in range(10)]
FUSED = planar_trajectory([100 * i for i in range(10)], ODOM)


def test_a_drive_that_was_not_found_has_no_poses():
    found = DriveInMap([Localisation.SEARCHING] * 3, [], None)
    assert len(found.trajectory(FUSED).stamps_ns) == 0


def test_the_odometry_continues_the_pose_of_each_keyframe_until_the_next_one():
    in_map = np.array([5.0, 2.0, np.pi / 2])
    keyframes = [(300, in_map), (700, planar.compose(in_map, np.array([0.41, 0.0, 0.0])))]
    mapped = DriveInMap([Localisation.LOCALISED] * 2, keyframes, 1.0).trajectory(FUSED)
    assert mapped.stamps_ns.tolist() == [300, 400, 500, 600, 700, 800, 900]
    np.testing.assert_allclose(mapped.positions[:, 0], 5.0, atol=1e-9)
    np.testing.assert_allclose(mapped.positions[:, 1], 2.0 + np.array([0.0, 0.1, 0.2, 0.3, 0.41, 0.51, 0.61]))
