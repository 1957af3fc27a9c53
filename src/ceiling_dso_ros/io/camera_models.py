# SPDX-License-Identifier: BSD-3-Clause
"""Camera calibrations: a raw camera and the pinhole it is undistorted to, from `camera.txt`."""

from dataclasses import dataclass
from pathlib import Path
from typing import List, Sequence, Tuple, Union

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.io.errors import FrameError, InputError
from ceiling_dso_ros.io.lens_models import LensCamera, check_whole_sensor
from ceiling_dso_ros.io.limits import MOST_PIXELS
from ceiling_dso_ros.io.output_camera import crop_camera, full_camera
from ceiling_dso_ros.io.text_files import read_lines

# Lens model -> what follows the name in the first line of camera.txt.
CAMERA_FILE_NUMBERS = {
    "Pinhole": "fx fy cx cy 0",
    "RadTan": "fx fy cx cy k1 k2 p1 p2",
    "EquiDistant": "fx fy cx cy k1 k2 k3 k4",
    "FOV": "fx fy cx cy omega",
}
RADTAN_COUNTS = (8, 9, 12)  # of numbers: OpenCV's k3, or k3 k4 k5 k6, may follow p2


@dataclass(frozen=True)
class CameraCalibration:
    """A raw camera and the pinhole that its images are undistorted to.

    Attributes:
        lens: the raw camera.
        camera: the undistorted camera.
    """

    lens: LensCamera
    camera: PinholeCamera

    @property
    def keeps_images(self) -> bool:
        """Raw images are those of the pinhole already."""
        lens, camera = self.lens, self.camera
        same = (lens.fx, lens.fy, lens.cx, lens.cy) == (camera.fx, camera.fy, camera.cx, camera.cy)
        return same and lens.model == "Pinhole" and (lens.width, lens.height) == (camera.width, camera.height)

    @property
    def image_size(self) -> Tuple[int, int]:
        """Width and height of the raw camera's images."""
        return self.lens.width, self.lens.height

    def require_size_of(self, image: np.ndarray) -> None:
        """Refuse an (H, W) image of another size than the raw camera's.

        Raises:
            FrameError: naming both sizes.
        """
        height, width = image.shape
        if (width, height) != self.image_size:
            raise FrameError(
                f"the image is {width}x{height}, but the calibration is for {self.lens.width}x{self.lens.height}"
            )


def read_camera_file(path: Union[str, Path]) -> CameraCalibration:
    """Read the four lines of a TUM-mono `camera.txt`: lens, input size, output, output size.

    Intrinsics may be relative to the image size, where fx = fx_relative * width and cx = cx_relative * width - 0.5.

    Raises:
        InputError: naming the line and what was expected there.
    """
    lines = read_lines(Path(path))
    if len(lines) != 4:
        raise InputError(
            f"{path}: {len(lines)} lines instead of 4: lens, 'width height', output (crop, full, none or "
            "'fx fy cx cy 0'), 'width height' of the output"
        )
    (lens_where, lens_line), (size_where, size_line), (output_where, output_line), (out_where, out_line) = lines
    size = _parse_size(size_line, size_where)
    lens = _parse_lens(lens_line, size, lens_where)
    out_size = _parse_size(out_line, out_where)
    return CameraCalibration(lens, _parse_output(output_line, lens, out_size, output_where))


def camera_file(lens: LensCamera, output_size: Tuple[int, int], comments: Sequence[str] = ()) -> str:
    """The text of a `camera.txt` with `crop`; it is read back as the very same lens.

    Args:
        lens: the raw camera.
        output_size: width and height of the undistorted images, pixels.
        comments: lines at its head, without the #.
    """
    numbers = [lens.fx, lens.fy, lens.cx, lens.cy, *(lens.distortion or (0.0,))]
    return "\n".join(
        [
            *(f"# {line}" for line in comments),
            " ".join([lens.model, *(repr(float(number)) for number in numbers)]),
            f"{lens.width} {lens.height}",
            "crop",
            "{} {}\n".format(*output_size),
        ]
    )


def _parse_lens(line: str, size: Tuple[int, int], where: str) -> LensCamera:
    """First line: a model's name and its numbers, or five numbers alone, which are those of FOV."""
    name, *words = line.split()
    if name not in CAMERA_FILE_NUMBERS:
        if name[0].isalpha():
            raise InputError(f"{where}: the lens model '{name}' is not one of {', '.join(CAMERA_FILE_NUMBERS)}")
        name, words = "FOV", [name, *words]
    expected = f"expected '{name} {CAMERA_FILE_NUMBERS[name]}'"
    numbers = _parse_numbers(words, f"{where}: {expected}")
    if name == "Pinhole" and len(numbers) == 4:
        numbers.append(0.0)
    if len(numbers) not in (RADTAN_COUNTS if name == "RadTan" else (len(CAMERA_FILE_NUMBERS[name].split()),)):
        raise InputError(f"{where}: {len(numbers)} numbers; {expected}")
    distortion = tuple(numbers[4:])
    if name == "Pinhole" and any(distortion):
        raise InputError(f"{where}: the fifth number of a Pinhole must be 0; {expected}")
    if not any(distortion) and name != "EquiDistant":  # a fisheye without coefficients is still a fisheye
        name, distortion = "Pinhole", ()
    try:
        lens = LensCamera(name, *_in_pixels(numbers[:4], size), distortion, *size)
        check_whole_sensor(lens)
    except ValueError as error:
        raise InputError(f"{where}: {error}; {expected}") from error
    return lens


def _parse_size(line: str, where: str) -> Tuple[int, int]:
    try:
        width, height = (int(word) for word in line.split())
    except ValueError:
        raise InputError(f"{where}: '{line}'; expected 'width height' in pixels") from None
    if width <= 0 or height <= 0:
        raise InputError(f"{where}: the image size {width} {height} must be positive")
    if width * height > MOST_PIXELS:
        raise InputError(f"{where}: the image size {width} {height} is more than {MOST_PIXELS} pixels")
    return width, height


def _parse_output(line: str, lens: LensCamera, size: Tuple[int, int], where: str) -> PinholeCamera:
    """Third line: crop, full, none, or the intrinsics of the output."""
    try:
        if line == "crop":
            return crop_camera(lens, *size)
        if line == "full":
            return full_camera(lens, *size)
        if line == "none":
            return _unchanged(lens, size)
        numbers = _parse_output_numbers(line, where)
        return PinholeCamera(*_in_pixels(numbers, size), *size)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def _unchanged(lens: LensCamera, size: Tuple[int, int]) -> PinholeCamera:
    if lens.model != "Pinhole":
        raise ValueError(f"'none' leaves images as they are, and those of a {lens.model} lens are distorted; use crop")
    if size != (lens.width, lens.height):
        raise ValueError("'none' leaves images as they are, and the output has another size than the input; use crop")
    return PinholeCamera(lens.fx, lens.fy, lens.cx, lens.cy, *size)


def _parse_output_numbers(line: str, where: str) -> List[float]:
    expected = "expected crop, full, none or 'fx fy cx cy 0' of the output"
    numbers = _parse_numbers(line.split(), f"{where}: {expected}")
    if len(numbers) not in (4, 5):
        raise InputError(f"{where}: {len(numbers)} numbers; {expected}")
    if any(numbers[4:]):
        raise InputError(f"{where}: the fifth number must be 0, the output is without distortion; {expected}")
    return numbers[:4]


def _parse_numbers(words: Sequence[str], complaint: str) -> List[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{complaint}; {error}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"{complaint}; a number is not finite")
    return numbers


def _in_pixels(intrinsics: Sequence[float], size: Tuple[int, int]) -> Tuple[float, float, float, float]:
    """Absolute fx fy cx cy of absolute ones or of those relative to the size."""
    fx, fy, cx, cy = intrinsics
    width, height = size
    small = (fx <= 10, fy <= 10, cx <= 1, cy <= 1)  # fx > 1 occurs: the relative focal length of a tele lens
    if all(small):
        return fx * width, fy * height, cx * width - 0.5, cy * height - 0.5
    if any(small):
        raise ValueError(f"{fx:g} {fy:g} {cx:g} {cy:g} are neither all in pixels nor all relative to the image size")
    return fx, fy, cx, cy
