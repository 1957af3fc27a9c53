# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.lidar.config import LidarConfig
from ceiling_dso_ros.lidar.mapping.loops import LoopFinder
from ceiling_dso_ros.lidar.scans.poses import between, compose, inverse, transformed

CONFIG = LidarConfig(submap_keyframes=8)
pytestmark = pytest.mark.long


def rooms(rng):
    """Walls of a house whose rooms all differ, 16 x 8 m, as points."""
    boxes = [
        (0.0, 0.0, 16.0, 8.0),
        *((*rng.uniform((0.5, 0.5), (13.5, 6.0)), *rng.uniform(0.3, 1.5, 2)) for _ in range(14)),
    ]
    points = []
    for x, y, width, height in boxes:
        along = np.arange(0.0, 1.0, 0.02 / max(width, height) * 2)[:, None]
        for start, end in (((0, 0), (1, 0)), ((1, 0), (1, 1)), ((1, 1), (0, 1)), ((0, 1), (0, 0))):
            points.append(np.array([x, y]) + (np.array(start) + along * np.subtract(end, start)) * (width, height))
    return np.concatenate(points)


def there_and_back(count=40):
    x = np.concatenate([np.linspace(2.0, 14.0, count // 2), np.linspace(14.0, 2.0, count // 2)])
    return np.column_stack([x, np.full(count, 4.0), np.repeat([0.0, np.pi], count // 2)])


def test_who_comes_back_is_recognised_although_the_way_has_drifted():
    rng = np.random.default_rng(0)
    house, truth = rooms(rng), there_and_back()
    points = []
    for pose in truth:
        seen = transformed(house, inverse(pose))
        points.append(seen[np.hypot(*seen.T) < 5.0] + 0.01 * rng.standard_normal((np.sum(np.hypot(*seen.T) < 5.0), 2)))
    drifted = [truth[0]]
    for step in between(truth[:-1], truth[1:]):
        drifted.append(compose(drifted[-1], step + np.array([0.01, 0.005, 0.004])))
    drifted = np.array(drifted)
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T)))
    finder = LoopFinder(points.__getitem__, points.__getitem__, way_m, 8.0, CONFIG)
    loops = finder.find(drifted)
    assert len(loops) >= 3
    for loop in loops:
        right = between(truth[[loop.first]], truth[[loop.second]])[0]
        error = between(right[None], loop.moved[None])[0]
        # a submap itself has drifted by some centimetres over its eight keyframes
        assert np.hypot(*error[:2]) < 0.15 and abs(error[2]) < 0.04
    connected = {(loop.first // 4, loop.second // 4) for loop in loops}
    assert not connected & {(loop.first // 4, loop.second // 4) for loop in finder.find(drifted)}


def test_an_endless_corridor_gives_no_loops():
    rng = np.random.default_rng(1)
    x = np.arange(-30.0, 50.0, 0.03)
    walls = np.concatenate([np.column_stack([x, np.full(len(x), y)]) for y in (3.0, 5.0)])
    truth = there_and_back()
    points = []
    for pose in truth:
        seen = transformed(walls, inverse(pose))
        points.append(seen[np.hypot(*seen.T) < 8.0])
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T)))
    finder = LoopFinder(points.__getitem__, points.__getitem__, way_m, 10.0, CONFIG)
    assert finder.find(truth + 0.01 * rng.standard_normal(truth.shape)) == []
