# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from ceiling_dso_ros.experiments.scanned_drive import ScannedDrive
from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.matching.tracking import ScanTracker
from ceiling_dso_ros.lidar.uncertainty import aligned_errors
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.sensors.laser import LaserModel

pytestmark = pytest.mark.long
CONFIG = LidarConfig()
LASER = LaserModel(rays=361, range_noise_m=0.02)


@pytest.fixture(scope="module")
def drive():
    return ScannedDrive(SimulationConfig("square", seed=5, duration_s=14.0, laser=LASER, traffic=5))


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("with_wheels", [False, True])
def test_scans_are_tracked(drive, with_wheels, backwards):
    track = ScanTracker(drive.scans, drive.wheels if with_wheels else None, CONFIG, backwards).run()
    assert track.is_matched.all()
    errors = aligned_errors(track.poses, drive.truth)
    assert np.hypot(*errors[:, :2].T).max() < 0.05
    # it has to be right within a landmark, 0.3 m, some metres away: what is left is for the joint solution
    assert np.abs(errors[:, 2]).max() < np.radians(3.0)
    scans = [keyframe.scan for keyframe in track.keyframes]
    assert scans == sorted(scans, reverse=backwards)
    assert scans[0] == (len(drive.scans) - 1 if backwards else 0)
    moved = np.hypot(*np.array([keyframe.moved[:2] for keyframe in track.keyframes[1:]]).T)
    assert moved.max() < 2 * CONFIG.keyframe_m


def test_where_nothing_is_seen_the_wheels_go_on(drive):
    ranges = drive.scans.ranges_m.copy()
    blind = slice(60, 90)
    ranges[blind] = np.nan
    track = ScanTracker(replace(drive.scans, ranges_m=ranges), drive.wheels, CONFIG).run()
    assert not track.is_matched[blind].any()
    assert track.is_matched[:60].all() and track.is_matched[90:].all()
    errors = aligned_errors(track.poses, drive.truth)
    assert np.hypot(*errors[:, :2].T).max() < 0.15, "3 m by wheels whose base is wrong by a hundredth"


def test_who_is_lost_begins_again(drive):
    """Without wheels, after 4 s without scans at 1 m/s, nothing fits any more where it is expected."""
    kept = np.r_[0:40, 100:130]
    track = ScanTracker(drive.scans.select(kept), None, replace(CONFIG, least_fit=0.7)).run()
    errors = aligned_errors(track.poses[-15:], drive.truth[kept][-15:])
    assert np.hypot(*errors[:, :2].T).max() < 0.05, "the second part is right by itself"
