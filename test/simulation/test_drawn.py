# SPDX-License-Identifier: BSD-3-Clause
"""Drives with a hall, a camera and wheels that are drawn at random."""

import numpy as np
import pytest
import yaml

from ceiling_dso_ros.cli.main import main
from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.drawn import draw_camera, draw_config, draw_wheels
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.robot import WheelErrors


def test_every_drawn_drive_is_in_range_and_depends_on_its_seed_alone():
    configs = [draw_config("loops", seed) for seed in range(100)]
    for config in configs:
        config.check()
    assert configs[5] == draw_config("loops", 5)
    assert len({str(config) for config in configs}) == 100
    told = sum(config.exposures_told for config in configs)
    assert 40 < told < 80
    for name in ("blur_px", "jpeg_quality", "vignette", "exposure_follows"):
        assert 0 < sum(bool(getattr(config.camera, name)) for config in configs) < 100, name
    slips = [config.wheels.turn_slip for config in configs]
    assert 0.008 < np.median(slips) < 0.012


def test_what_is_given_is_not_drawn():
    assert draw_camera(3, read_noise=0.1).read_noise == 0.1
    assert draw_camera(3, read_noise=0.1).shot_noise == draw_camera(3).shot_noise
    assert draw_wheels(3, ratio=0.0).ratio == 0.0
    with pytest.raises(ConfigError, match="seed -1"):
        draw_config("loops", -1)


def test_wheels_that_turn_the_robot_slip_a_little():
    """On the spot at about 1 rad/s each wheel turns further by about the share, and not at all on a straight line."""

    def ticks(sequence, share):
        wheels = WheelErrors(ratio=0.0, wheel_base=0.0, travel_noise_m=0.0, tick_noise=0.0, turn_slip=share)
        simulated = SimulatedRecording(draw_config(sequence, 2, duration_s=6.0, wheels=wheels)).simulation
        counted = simulated.encoders.ticks
        yaws = simulated._motion.poses(simulated.encoders.time_s)[:, 2]
        return np.abs(counted[-1] - counted[0]), np.abs(np.gradient(yaws, simulated.encoders.time_s))

    (rolled, rates), (slipped, _) = ticks("spin", 0.0), ticks("spin", 0.01)
    expected = 0.01 * (rates**2).sum() / rates.sum()  # the mean rate over the way
    np.testing.assert_allclose(slipped / rolled - 1.0, expected, rtol=0.05)
    np.testing.assert_allclose(ticks("straight", 0.01)[0], ticks("straight", 0.0)[0], atol=1)


def test_a_lens_that_is_not_in_focus_and_jpeg():
    light = np.zeros((64, 64), np.float32)
    light[:, 32:] = 0.8
    sharp = CameraModel(64, 64, read_noise=0.0, shot_noise=0.0)
    blurred = CameraModel(64, 64, read_noise=0.0, shot_noise=0.0, blur_px=2.0)
    packed = CameraModel(64, 64, read_noise=0.0, shot_noise=0.0, jpeg_quality=30)
    images = [camera.develop(light.copy(), np.random.default_rng(0)) for camera in (sharp, blurred, packed)]
    steepest = [np.diff(image.astype(float), axis=1).max() for image in images]
    assert steepest[0] == 204
    assert steepest[1] == pytest.approx(204 / np.sqrt(2 * np.pi) / 2.0, rel=0.05)
    assert images[2].dtype == np.uint8
    assert 0.0 < np.abs(images[2].astype(float) - images[0]).mean() < 10.0


def test_simulate_draws_and_says_what(tmp_path):
    bag = tmp_path / "drawn.bag"
    small = ["--size", "212x120", "--fps", "10", "--duration", "0.6"]
    command = ["simulate", "loops", "--ceiling", "random", "--seed", "14", "--out", str(bag), *small]
    assert main([*command, "--read-noise", "2.5", "--no-exposure"]) == 0
    truth = yaml.safe_load((tmp_path / "drawn.truth.yaml").read_text())
    assert truth["hall"]["roof"] == "pitched"
    assert truth["hall"]["hangings"]
    assert truth["config"]["ceiling"] == "random"
    assert truth["config"]["camera"]["read_noise"] == 2.5
    assert truth["config"]["camera"]["shot_noise"] == draw_camera(14).shot_noise
    frames = list(open_recording(bag).frames(0.0))
    assert len(frames) == 5
    assert all(frame.exposure_ms is None for frame in frames)
