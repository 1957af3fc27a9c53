# SPDX-License-Identifier: BSD-3-Clause
"""Camera calibrations of sensor_msgs/CameraInfo, for bags and for the nodes."""

import re
from typing import Any, Dict, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from numpy.typing import ArrayLike

from ceiling_dso_ros.io.camera_models import CameraCalibration
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.lens_models import LensCamera, check_whole_sensor
from ceiling_dso_ros.io.output_camera import crop_camera

BROWN_COUNTS, FISHEYE_COUNTS = (4, 5, 8), (4,)  # of coefficients
LENS_OF_MODEL = {
    "plumb_bob": ("RadTan", BROWN_COUNTS),
    "rational_polynomial": ("RadTan", BROWN_COUNTS),
    "": ("RadTan", BROWN_COUNTS[1:]),  # before there were names; with four coefficients it could be a fisheye
    "equidistant": ("EquiDistant", FISHEYE_COUNTS),
    "fisheye": ("EquiDistant", FISHEYE_COUNTS),
}
SAYS_RECTIFIED = re.compile(r"(^|[/_])rect(ified)?($|[/_])")  # a word of a topic's name


class Window(NamedTuple):
    """Region of interest in pixels of the whole sensor; of width or height 0 it reaches to the border."""

    x_offset: int = 0
    y_offset: int = 0
    width: int = 0
    height: int = 0


def camera_info_fields(message: Any) -> Dict[str, Any]:  # noqa: ANN401
    """What describes the camera in a sensor_msgs/CameraInfo, of rospy or of a bag, as arguments of the next function.

    Equal results mean an unchanged camera.
    """
    roi = message.roi
    return {
        "width": message.width,
        "height": message.height,
        "distortion_model": message.distortion_model,
        **{name: tuple(float(value) for value in getattr(message, name)) for name in ("D", "K", "P")},
        "binning": (message.binning_x, message.binning_y),
        "roi": Window(roi.x_offset, roi.y_offset, roi.width, roi.height),
    }


def calibration_from_camera_info(
    width: int,
    height: int,
    distortion_model: str,
    D: Sequence[float],
    K: ArrayLike,
    P: ArrayLike = (),
    rectified: bool = False,
    binning: Tuple[int, int] = (1, 1),
    roi: Window = Window(),
    image_size: Optional[Tuple[int, int]] = None,
    source: str = "camera_info",
) -> CameraCalibration:
    """Calibration of the fields of a sensor_msgs/CameraInfo.

    Distorted images are undistorted with `crop`. Images without distortion are used as they are.

    Args:
        width: pixels of the whole sensor, as calibrated.
        height: pixels of the whole sensor, as calibrated.
        distortion_model: plumb_bob, rational_polynomial or equidistant; not used where D is empty.
        D: coefficients of the raw image.
        K: (9,) or (3, 3) of the raw image.
        P: (12,) or (3, 4), needed when rectified.
        rectified: the images are those that P describes, K and D are ignored.
        binning: pixels of the sensor that one of the image stands for, horizontally and vertically; 0 is 1.
        roi: what the images show of the sensor, before binning.
        image_size: (width, height) of the images, None if unknown. Images of the whole width and height are those that
            K describes: some drivers name their binning and region of interest although K takes them into account.
        source: names the message in errors.

    Raises:
        InputError: the numbers describe no camera.
    """
    name, columns = ("P", 4) if rectified else ("K", 3)
    matrix = np.asarray(P if rectified else K, dtype=np.float64).reshape(-1)
    if matrix.size != 3 * columns:
        raise InputError(f"{source}: {name} has {matrix.size} numbers instead of {3 * columns}")
    fx, fy, cx, cy = matrix[[0, columns + 1, 2, columns + 2]].tolist()
    model, distortion = ("Pinhole", ()) if rectified else _lens(distortion_model, D, source)
    try:
        whole = LensCamera(model, fx, fy, cx, cy, distortion, width, height)
        check_whole_sensor(whole)
    except ValueError as error:
        raise InputError(f"{source}: {error}; is the camera calibrated?") from error
    try:
        lens = _seen_part(whole, binning, roi, image_size)
        return CameraCalibration(lens, crop_camera(lens, lens.width, lens.height))
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error


def distorted_though_rectified(topic: str, D: Sequence[float]) -> Optional[str]:
    """A warning if the images of a topic are rectified by its name, but will be undistorted; else None.

    Args:
        topic: of the images.
        D: coefficients in their camera_info.
    """
    if not any(D) or SAYS_RECTIFIED.search(topic) is None:
        return None
    return (
        f"{topic}: by its name these images are rectified, but they are undistorted with D of camera_info, which is "
        "not zero; if they are rectified, give --rectified, or rectified:=true to the launch file"
    )


def _lens(distortion_model: str, D: Sequence[float], source: str) -> Tuple[str, Tuple[float, ...]]:
    """Lens model and its coefficients."""
    distortion = tuple(float(value) for value in D)
    lens, counts = LENS_OF_MODEL.get(distortion_model, ("", ()))
    if not any(distortion) and lens != "EquiDistant":  # a fisheye of zeros is still a fisheye
        return "Pinhole", ()
    if not lens:
        known = ", ".join(filter(None, LENS_OF_MODEL))
        raise InputError(f"{source}: distortion model '{distortion_model}' is not known, only {known}")
    most = max(counts)
    if not any(distortion[most:]):  # OpenCV's further coefficients, of thin prisms and tilted sensors, are not used
        distortion = distortion[:most]
    if len(distortion) not in counts:
        expected = ", ".join(map(str, counts[:-1])) + (" or " if counts[1:] else "") + str(most)
        model = distortion_model or "an unnamed distortion model"
        raise InputError(f"{source}: {len(distortion)} coefficients in D instead of {expected} for {model}")
    return lens, distortion


def _seen_part(
    whole: LensCamera, binning: Tuple[int, int], roi: Window, image_size: Optional[Tuple[int, int]]
) -> LensCamera:
    """The raw camera of the images, which show a part of the sensor with fewer pixels.

    Raises:
        ValueError: the region of interest is not within the sensor.
    """
    binned_x, binned_y = (max(factor, 1) for factor in binning)
    width, height = roi.width or whole.width - roi.x_offset, roi.height or whole.height - roi.y_offset
    size = width // binned_x, height // binned_y
    is_outside = roi.x_offset + width > whole.width or roi.y_offset + height > whole.height
    if image_size == (whole.width, whole.height) and (is_outside or image_size != size):
        return whole
    if is_outside or min(size) <= 0:
        raise ValueError(
            f"the region of interest, {width}x{height} at ({roi.x_offset}, {roi.y_offset}) with binning {binned_x}x"
            f"{binned_y}, is not within the sensor of {whole.width}x{whole.height}"
        )
    # The edges of the pixels are what binning leaves in place, half a pixel beyond the centres.
    cx = (whole.cx - roi.x_offset + 0.5) / binned_x - 0.5
    cy = (whole.cy - roi.y_offset + 0.5) / binned_y - 0.5
    return LensCamera(whole.model, whole.fx / binned_x, whole.fy / binned_y, cx, cy, whole.distortion, *size)
