# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.simulation.camera import REFERENCE_EXPOSURE_MS, CameraModel, ExposureControl
from ceiling_dso_ros.simulation.events import parse_events

SMALL = {"width": 212, "height": 120}


def develop(model, level, seed=0):
    radiance = np.full((model.height, model.width), level / 255.0, dtype=np.float32)
    return model.develop(radiance, np.random.default_rng(seed)).astype(float)


@pytest.mark.parametrize("level", [0.0, 10.3, 60.0, 143.7, 230.0])
def test_noise_has_the_configured_size_and_no_bias(level):
    model = CameraModel(**SMALL, read_noise=1.0, shot_noise=3.0)
    image = develop(model, level)
    sigma = model.noise_sigma(np.array(level))
    assert sigma == pytest.approx(np.sqrt(1.0 + 9.0 * level / 255.0))
    if level > 5.0:
        assert image.mean() == pytest.approx(level, abs=4 * sigma / 160)
        assert image.std() == pytest.approx(np.hypot(sigma, 1 / np.sqrt(12)), rel=0.02)


def test_without_noise_levels_are_rounded_and_saturate():
    model = CameraModel(**SMALL, read_noise=0.0, shot_noise=0.0)
    for level, expected in ((99.6, 100), (0.2, 0), (255.0, 255), (900.0, 255)):
        assert (develop(model, level) == expected).all()


def test_the_photometric_calibration_undoes_response_and_vignette():
    model = CameraModel(**SMALL, read_noise=0.0, shot_noise=0.0, response_gamma=1.8, vignette=0.4)
    image = develop(model, 120.0)
    assert np.ptp(image) > 20, "corners are darker"
    corrected = model.photometric.correct(image.astype(np.uint8))
    np.testing.assert_allclose(corrected, 120.0, atol=1.0)


def test_the_size_scales_the_focal_length():
    full, half = CameraModel().pinhole, CameraModel(width=424, height=240).pinhole
    assert half.fx == pytest.approx(full.fx / 2)
    assert half.cx + 0.5 == pytest.approx((full.cx + 0.5) / 2)


def test_distortion_moves_every_pixel_to_where_the_lens_projects_it():
    model = CameraModel(**SMALL, distortion=(-0.12, 0.03, 0.001, -0.002))
    camera = model.pinhole
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays_x, rays_y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    picture_x, picture_y = model.distort(rays_x.astype(np.float32)), model.distort(rays_y.astype(np.float32))
    u, v = model.lens.pixels(picture_x.astype(float), picture_y.astype(float))
    columns, rows = np.meshgrid(np.arange(model.width), np.arange(model.height))
    for error in (u - columns, v - rows):  # cv2.remap rounds to a 32nd of a pixel
        assert np.abs(error).max() < 0.04 and np.abs(error).mean() < 0.015


def test_a_rectified_camera_distorts_nothing():
    picture = np.random.default_rng(0).random((120, 212), dtype=np.float32)
    assert CameraModel(**SMALL).distort(picture) is picture


@pytest.mark.parametrize(
    "settings",
    [
        {"width": 850},
        {"height": 40},
        {"fps": 0.0},
        {"read_noise": -1.0},
        {"shot_noise": float("nan")},
        {"vignette": 1.0},
        {"response_gamma": 0.0},
        {"distortion": (0.1,)},
        {"distortion": (9.0, 0.0, 0.0, 0.0)},
    ],
)
def test_impossible_cameras_are_refused(settings):
    with pytest.raises(ConfigError):
        CameraModel(**settings).check()


def test_exposure_drifts_by_its_share_around_the_reference():
    control = ExposureControl(CameraModel(exposure_drift=0.1), [], np.random.default_rng(0))
    exposures = np.log([control.exposure_ms(t) / REFERENCE_EXPOSURE_MS for t in np.arange(0.0, 600.0, 0.5)])
    assert exposures.std() == pytest.approx(0.1, rel=0.2)
    assert np.abs(np.diff(exposures)).max() < 0.1


def test_exposure_follows_the_light_with_a_lag():
    events = parse_events(["lights_off@10"], 30.0)
    control = ExposureControl(CameraModel(exposure_drift=0.0), events, np.random.default_rng(0))
    before, soon, late = (control.exposure_ms(t) for t in (9.9, 10.3, 20.0))
    assert before == pytest.approx(REFERENCE_EXPOSURE_MS)
    assert before < soon < 0.8 * late
    assert late == 14.0, "as long as it may"
