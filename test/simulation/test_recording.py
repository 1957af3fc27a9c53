# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.recording import Frame
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording

CAMERA = CameraModel(width=104, height=64, response_gamma=1.4)


@pytest.fixture(scope="module")
def recording():
    return SimulatedRecording(
        SimulationConfig("straight", "plaster", camera=CAMERA, duration_s=1.0, time_offset_s=0.01)
    )


def test_it_plays_like_any_other_recording(recording):
    frames = [*recording.frames()]
    assert len(frames) == len(recording) > 25
    assert all(isinstance(frame, Frame) for frame in frames)
    assert frames[3].image.shape == (64, 104)
    assert frames[3].exposure_ms == recording.simulation.frame(3).exposure_ms
    assert recording.name == "simulated_straight_plaster_0"


def test_its_calibration_is_that_of_the_camera(recording):
    assert recording.calibration.keeps_images
    assert recording.calibration.camera == CAMERA.pinhole
    np.testing.assert_array_equal(recording.photometric.inverse_response, CAMERA.photometric.inverse_response)


def test_the_robot_is_the_nominal_one(recording):
    assert recording.robot == recording.simulation.nominal
    assert recording.robot.wheel_radius_m != recording.simulation.robot.true.wheel_radius_m


def test_the_truth_has_the_stamps_of_images_and_wheels(recording):
    frames = [*recording.frames()]
    np.testing.assert_array_equal(recording.camera_truth.stamps_ns, [frame.stamp_ns for frame in frames])
    np.testing.assert_array_equal(recording.base_truth.stamps_ns, recording.wheels.stamps_ns)
    simulation = recording.simulation
    expected = simulation.robot.T_world_camera(simulation.frame_times_s)
    np.testing.assert_allclose(recording.camera_truth.matrices(), expected, atol=1e-12)
    assert recording.ground_truth_path is None
