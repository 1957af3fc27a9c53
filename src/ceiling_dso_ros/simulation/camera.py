# SPDX-License-Identifier: BSD-3-Clause
"""The camera: a D455's infrared imager (global shutter, rectified), from radiance to grey levels."""

from array import array
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Sequence, Tuple

import cv2
import numpy as np

from ceiling_dso_ros.dso.config import require
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.io.grey_range import GREY_LEVELS
from ceiling_dso_ros.io.lens_models import LensCamera
from ceiling_dso_ros.io.photometric import PhotometricCalibration
from ceiling_dso_ros.simulation.events import Event, light_level

NATIVE_WIDTH, NATIVE_FOCAL_PX = 848, 425.3
CENTER_OFFSET_PX = (2.4, -1.3)  # principal point from the middle of the native image
OVERSAMPLING = 1.5  # resolution of an image before distortion, so that interpolation blurs little
REFERENCE_EXPOSURE_MS = 5.6  # the exposure at which radiance 1 saturates

FRAME_JITTER_S, LARGEST_JITTER_S = 1.5e-4, 1e-3


def frame_jitter_s(rng: np.random.Generator, count: int) -> np.ndarray:
    """How much later than planned images are taken, (count,) seconds."""
    return np.clip(FRAME_JITTER_S * rng.standard_normal(count), -LARGEST_JITTER_S, LARGEST_JITTER_S)


@dataclass(frozen=True)
class CameraModel:
    """Properties of a camera.

    Attributes:
        width, height: pixels, multiples of 4.
        fps: frames per second.
        read_noise: standard deviation of the noise in the dark, grey levels.
        shot_noise: standard deviation of the photon noise at full scale, grey levels; it grows with the square root of
            the light.
        exposure_drift: standard deviation of the logarithm of the exposure time, which drifts over seconds.
        response_gamma: the grey level is proportional to the light to the power of 1 / gamma.
        vignette: share of the light that the corners lose.
        distortion: k1 k2 p1 p2 of a radial-tangential lens; empty when rectified.
        blur_px: standard deviation of the blur of a lens that is not in focus.
        jpeg_quality: images are compressed with losses, 1 to 100; 0: they are not.
        exposure_follows: the exposure time follows the light; otherwise it is fixed.
        lens_error: what the calibration in the recording says too much: share of both focal lengths, pixels of the
            principal point (2), and k1; empty for a calibration that is right.
    """

    width: int = 848
    height: int = 480
    fps: float = 30.0
    read_noise: float = 0.7
    shot_noise: float = 1.8
    exposure_drift: float = 0.08
    response_gamma: float = 1.0
    vignette: float = 0.0
    distortion: Tuple[float, ...] = ()
    blur_px: float = 0.0
    jpeg_quality: int = 0
    exposure_follows: bool = True
    lens_error: Tuple[float, ...] = ()

    def check(self) -> None:
        """Raise ConfigError when a value is out of range."""
        size = f"size {self.width}x{self.height}"
        require(self.width % 4 == 0 and self.height % 4 == 0, f"{size}: width and height must be multiples of 4")
        require(64 <= self.width <= 1920 and 64 <= self.height <= 1440, f"{size}: 64x64 to 1920x1440")
        require(1.0 <= self.fps <= 120.0, f"fps {self.fps:g}: 1 to 120")
        require(0.0 <= self.read_noise <= 20.0, f"read noise {self.read_noise:g}: 0 to 20 grey levels")
        require(0.0 <= self.shot_noise <= 20.0, f"shot noise {self.shot_noise:g}: 0 to 20 grey levels")
        require(0.0 <= self.exposure_drift <= 0.5, f"exposure drift {self.exposure_drift:g}: 0 to 0.5")
        require(0.5 <= self.response_gamma <= 3.0, f"response gamma {self.response_gamma:g}: 0.5 to 3")
        require(0.0 <= self.vignette <= 0.8, f"vignette {self.vignette:g}: 0 to 0.8")
        require(len(self.distortion) in (0, 4), "distortion: give k1 k2 p1 p2 or nothing")
        require(all(abs(k) <= 0.5 for k in self.distortion), f"distortion {self.distortion}: each -0.5 to 0.5")
        require(len(self.lens_error) in (0, 4), "lens error: give focal length, cx, cy, k1 or nothing")
        for error, limit in zip(self.lens_error, (0.1, 0.1 * self.width, 0.1 * self.width, 0.2)):
            require(abs(error) <= limit, f"lens error {error:g}: -{limit:g} to {limit:g}")
        require(0.0 <= self.blur_px <= 5.0, f"blur {self.blur_px:g}: 0 to 5 pixels")
        require(0 <= self.jpeg_quality <= 100, f"JPEG quality {self.jpeg_quality}: 1 to 100, or 0 for none")

    @cached_property
    def lens(self) -> LensCamera:
        """The raw camera."""
        scale = self.width / NATIVE_WIDTH
        cx, cy = ((side - 1) / 2 + scale * offset for side, offset in zip((self.width, self.height), CENTER_OFFSET_PX))
        model = "RadTan" if self.distortion else "Pinhole"
        focal = NATIVE_FOCAL_PX * scale
        return LensCamera(model, focal, focal, cx, cy, self.distortion, self.width, self.height)

    @property
    def told_lens(self) -> LensCamera:
        """The raw camera as the recording's calibration has it."""
        lens = self.lens
        if not self.lens_error:
            return lens
        focal, cx, cy, k1 = self.lens_error
        first, *others = lens.distortion or (0.0, 0.0, 0.0, 0.0)
        return LensCamera(
            "RadTan",
            lens.fx * (1.0 + focal),
            lens.fy * (1.0 + focal),
            lens.cx + cx,
            lens.cy + cy,
            (first + k1, *others),
            lens.width,
            lens.height,
        )

    @cached_property
    def pinhole(self) -> PinholeCamera:
        """The pinhole camera that is rendered; without rectification its view covers that of the lens."""
        lens = self.lens
        if not self.distortion:
            return PinholeCamera(lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height)
        focal = OVERSAMPLING * lens.fx
        cx, cy = np.ceil(np.abs(self._rays).max(axis=(0, 1)) * focal + 4)
        return PinholeCamera(focal, focal, cx, cy, int(2 * cx + 1), int(2 * cy + 1))

    @property
    def photometric(self) -> PhotometricCalibration:
        """Inverse response and vignette."""
        inverse = 255.0 * (np.arange(GREY_LEVELS) / 255.0) ** self.response_gamma
        return PhotometricCalibration(inverse, self._vignette if self.vignette > 0 else None)

    def distort(self, radiance: np.ndarray) -> np.ndarray:
        """Distort an image of `pinhole` as the lens does."""
        if not self.distortion:
            return radiance
        columns, rows = self._map
        return cv2.remap(radiance, columns, rows, cv2.INTER_LINEAR)

    def noise_sigma(self, level: np.ndarray) -> np.ndarray:
        """Standard deviation of the noise at a linear grey level 0..255, of the same shape."""
        return np.sqrt(self.read_noise**2 + self.shot_noise**2 / 255.0 * level)

    def develop(self, light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Turn light into grey levels: blur, vignette, noise, saturation, response, rounding, JPEG.

        Args:
            light: (height, width) float32 where 1 saturates.
            rng: for the noise.

        Returns:
            (height, width) uint8.
        """
        level = light * np.float32(255.0)
        if self.blur_px > 0:
            level = cv2.GaussianBlur(level, (0, 0), self.blur_px, borderType=cv2.BORDER_REPLICATE)
        if self.vignette > 0:
            level *= self._vignette
        if self.read_noise > 0 or self.shot_noise > 0:
            level += rng.standard_normal(level.shape, dtype=np.float32) * self.noise_sigma(level).astype(np.float32)
        np.clip(level, 0.0, 255.0, out=level)
        if self.response_gamma != 1.0:
            level = 255.0 * (level / 255.0) ** np.float32(1.0 / self.response_gamma)
        return self._compressed(np.rint(level).astype(np.uint8))

    def _compressed(self, image: np.ndarray) -> np.ndarray:
        if not self.jpeg_quality:
            return image
        _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality))
        return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)

    @cached_property
    def _vignette(self) -> np.ndarray:
        x, y = np.arange(self.width) - (self.width - 1) / 2, np.arange(self.height) - (self.height - 1) / 2
        radius2 = (x[None, :] ** 2 + y[:, None] ** 2) / (x[0] ** 2 + y[0] ** 2)
        return (1.0 - self.vignette * radius2).astype(np.float32)

    @cached_property
    def _rays(self) -> np.ndarray:
        """Ideal coordinates (x, y) of each pixel of the lens, (height, width, 2)."""
        pixels = np.stack(np.meshgrid(np.arange(self.width), np.arange(self.height)), axis=-1).astype(np.float64)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        rays = cv2.undistortPointsIter(
            pixels.reshape(-1, 1, 2), self.lens.matrix, np.array(self.distortion), None, None, criteria
        )
        return rays.reshape(self.height, self.width, 2)

    @cached_property
    def _map(self) -> Tuple[np.ndarray, np.ndarray]:
        camera = self.pinhole
        columns, rows = np.moveaxis(self._rays, -1, 0)
        return (camera.fx * columns + camera.cx).astype(np.float32), (camera.fy * rows + camera.cy).astype(np.float32)


EXPOSURE_LIMITS_MS = (0.3, 14.0)
EXPOSURE_LAG_S = 0.8
DRIFT_PERIODS_S = (6.0, 11.0, 19.0, 37.0)
CONTROL_STEP_S = 0.02


class ExposureControl:
    """The camera's automatic exposure: it follows the light with a delay, and drifts slowly.

    Args:
        model: of the camera.
        events: those that change the light; further ones may be added, which count from then on.
        rng: for the drift.

    Attributes:
        phases: (4,) phases of the sines that make up the drift, radians.
    """

    def __init__(self, model: CameraModel, events: Sequence[Event], rng: np.random.Generator) -> None:
        self.phases = rng.uniform(0.0, 2 * np.pi, len(DRIFT_PERIODS_S))
        self._events = events
        self._drift = model.exposure_drift * np.sqrt(2.0 / len(DRIFT_PERIODS_S))
        self._follows = model.exposure_follows
        self._state = self._wanted(np.zeros(1))[0]
        self._followed = array("d")  # logarithm of the exposure without drift, every CONTROL_STEP_S
        self._lock = Lock()  # images are rendered by several threads

    def exposure_ms(self, time_s: float) -> float:
        """Exposure time of an image whose exposure's middle is at time_s."""
        before = int(time_s / CONTROL_STEP_S)
        with self._lock:
            self._follow(before + 2)
            followed = np.array(self._followed[before : before + 2])
        nodes_s = (before + np.arange(2)) * CONTROL_STEP_S
        waves = np.sin(2 * np.pi * nodes_s[:, None] / DRIFT_PERIODS_S + self.phases)
        logarithm = followed + self._drift * waves.sum(axis=1)
        return float(
            np.interp(time_s, nodes_s, np.clip(REFERENCE_EXPOSURE_MS * np.exp(logarithm), *EXPOSURE_LIMITS_MS))
        )

    def _follow(self, count: int) -> None:
        """Go on until so many nodes are known."""
        numbers = np.arange(len(self._followed), count)
        for target in self._wanted(numbers * CONTROL_STEP_S):
            self._state += CONTROL_STEP_S / EXPOSURE_LAG_S * (target - self._state)
            self._followed.append(self._state)

    def _wanted(self, time_s: np.ndarray) -> np.ndarray:
        return -np.log(light_level(self._events, time_s)) if self._follows else np.zeros(len(time_s))
