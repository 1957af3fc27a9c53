# SPDX-License-Identifier: BSD-3-Clause
"""Recordings in folders of the TUM-mono layout."""

import math
import zipfile
from array import array
from contextlib import ExitStack
from decimal import Decimal
from functools import cached_property, partial
from pathlib import Path
from typing import Callable, Dict, Iterator, List, NamedTuple, NoReturn, Optional, Set, Tuple

import numpy as np

from ceiling_dso_ros.io.camera_models import read_camera_file
from ceiling_dso_ros.io.errors import FrameError, InputError, reason_of
from ceiling_dso_ros.io.image_decoding import decode_compressed, require_image_bytes
from ceiling_dso_ros.io.photometric import read_photometric
from ceiling_dso_ros.io.recording import (
    ListedImage,
    Recording,
    RobotDescription,
    SecondCamera,
    WheelSamples,
    WheelUnit,
)
from ceiling_dso_ros.io.robot_file import read_robot_file
from ceiling_dso_ros.io.second_camera import read_second_camera
from ceiling_dso_ros.io.stamps import parse_stamp
from ceiling_dso_ros.io.text_files import increasing_stamps, place_of_line, read_table, stamps_of_file

RIGHT_CAMERA = "camera_right.txt"
# All files that a recording may have beside its images.
FILES = (
    "images.zip", "times.txt", "camera.txt", "pcalib.txt", "vignette.png", "encoders.csv", "robot.yaml",
    "groundtruth.tum", RIGHT_CAMERA, "rig.yaml",
)  # fmt: skip
IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".pgm", ".tif", ".tiff"}


class _Time(NamedTuple):
    where: str
    image_id: str
    stamp_ns: int
    exposure_ms: Optional[float]


class TumFolderRecording(Recording):
    """A folder with `images/` or `images.zip`, `times.txt`, `camera.txt`, and optional further files.

    Optional are `pcalib.txt` and `vignette.png` (photometric calibration), `encoders.csv` and `robot.yaml`,
    `groundtruth.tum`, and `camera_right.txt`, `images_right/` and `rig.yaml` of a second camera.
    """

    def __init__(self, path: Path, camera_file: Optional[Path] = None, robot_file: Optional[Path] = None) -> None:
        """Read everything but the images and the wheels.

        Raises:
            InputError: a file is missing or cannot be used.
        """
        self.path = path
        self._robot_file = robot_file or self._optional("robot.yaml")
        self._archive = None if (path / "images").is_dir() else self._optional("images.zip")
        self._images = _by_id(self._image_names())
        self._times = _read_times(path / "times.txt")
        if not any(time.image_id in self._images for time in self._times):
            raise InputError(f"{path / 'times.txt'}: none of the images listed is in {self._container}")
        self.calibration = read_camera_file(camera_file or path / "camera.txt")
        self._right = _RightFolder(path) if (path / RIGHT_CAMERA).exists() else None
        size = (self.calibration.lens.width, self.calibration.lens.height)
        self.photometric = read_photometric(self._optional("pcalib.txt"), self._optional("vignette.png"), size)

    def __len__(self) -> int:
        return len(self._times)

    def images(self) -> Iterator[ListedImage]:
        """See Recording."""
        with ExitStack() as stack:
            archive = None if self._archive is None else stack.enter_context(_opened(self._archive))
            listed: Set[str] = set()
            for time in self._times:
                file_name = self._images.get(time.image_id)
                name = time.where if file_name is None else str(self._container / file_name)
                # An image was taken at one time, so which of several lines is right cannot be known: the first counts.
                decode = _repeated if time.image_id in listed else partial(self._decode, archive, file_name)
                listed.add(time.image_id)
                right = None if self._right is None else self._right.image(time.image_id)
                yield ListedImage(time.stamp_ns, time.exposure_ms, name, decode, right=right)

    @cached_property
    def second_camera(self) -> Optional[SecondCamera]:
        """See Recording."""
        return None if self._right is None else self._right.camera()

    @cached_property
    def wheels(self) -> Optional[WheelSamples]:
        """See Recording."""
        path = self._optional("encoders.csv")
        return None if path is None else _read_encoders(path)

    @cached_property
    def robot(self) -> Optional[RobotDescription]:
        """See Recording."""
        return None if self._robot_file is None else read_robot_file(self._robot_file)

    @property
    def ground_truth_path(self) -> Optional[Path]:
        """See Recording."""
        return self._optional("groundtruth.tum")

    @property
    def _container(self) -> Path:
        return self._archive or self.path / "images"

    def _optional(self, name: str) -> Optional[Path]:
        path = self.path / name
        return path if path.exists() else None

    def _image_names(self) -> List[str]:
        """Names of all image files, relative to the container.

        Raises:
            InputError: there are none.
        """
        if self._archive is not None:
            with _opened(self._archive) as archive:
                names = archive.namelist()
        elif self._container.is_dir():
            names = [path.name for path in self._container.iterdir()]
        else:
            raise InputError(
                f"{self.path}: neither images/ nor images.zip is in it; a recording is a ROS 1 bag or a folder with "
                "images/, times.txt and camera.txt"
            )
        names = [name for name in names if Path(name).suffix.lower() in IMAGE_SUFFIXES]
        if not names:
            raise InputError(f"{self._container}: there are no images in it")
        return names

    def _decode(self, archive: Optional[zipfile.ZipFile], file_name: Optional[str]) -> np.ndarray:
        if file_name is None:
            raise FrameError(f"the image is not in {self._container}")
        if archive is not None:
            return decode_compressed(_member(archive, file_name))
        return _read_image(self._container / file_name)


class _RightFolder:
    """The second camera of a folder: images with the names of the first camera's in a folder of their own."""

    def __init__(self, path: Path) -> None:
        self._path = path
        folder = path / "images_right"
        if not folder.is_dir():
            raise InputError(f"{path / RIGHT_CAMERA}: its images are not there, in {folder}")
        names = [each.name for each in folder.iterdir() if each.suffix.lower() in IMAGE_SUFFIXES]
        self._images = {image_id: folder / name for image_id, name in _by_id(names).items()}

    def image(self, image_id: str) -> Optional[Callable[[], np.ndarray]]:
        """Gives the raw image that belongs to one of the first camera; None if there is none."""
        path = self._images.get(image_id)
        return None if path is None else partial(_read_image, path)

    def camera(self) -> SecondCamera:
        """Calibration and pose.

        Raises:
            InputError: a file cannot be used.
        """
        return read_second_camera(self._path / RIGHT_CAMERA, self._path / "rig.yaml")


def _read_image(path: Path) -> np.ndarray:
    try:
        require_image_bytes(path.stat().st_size)
        return decode_compressed(path.read_bytes())
    except OSError as error:
        raise FrameError(f"cannot read the image: {reason_of(error)}") from error


def _opened(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except OSError as error:
        raise InputError(f"{path}: cannot read the archive: {reason_of(error)}") from error
    except Exception as error:  # damaged archives end in errors of any kind
        raise InputError(f"{path}: cannot read the archive: {error}") from error


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    """An image in an archive; what it takes in memory is known before, and nothing is written anywhere."""
    require_image_bytes(archive.getinfo(name).file_size)
    try:
        return archive.read(name)  # never more than that
    except Exception as error:  # damaged and encrypted archives end in errors of any kind
        raise FrameError(f"cannot read the image: {error}") from error


def _repeated() -> NoReturn:
    raise FrameError("times.txt lists the image twice")


def _by_id(names: List[str]) -> Dict[str, str]:
    return {_image_id(Path(name).stem): name for name in sorted(names)}


def _image_id(text: str) -> str:
    """Identity of an image: its number, however many zeros it is padded with, or its name."""
    return (text.lstrip("0") or "0") if text.isdecimal() else text


def _read_times(path: Path) -> List[_Time]:
    rows = [_parse_time(text, path, number) for number, text in read_table(path)]
    if not rows:
        raise InputError(f"{path}: it lists no images; expected lines of 'id stamp exposure_ms'")
    places, ids, stamps, exposures = zip(*rows)
    return [_Time(*time) for time in zip(places, ids, stamps_of_file(path, stamps), exposures)]


def _parse_time(line: str, path: Path, number: int) -> Tuple[str, str, Decimal, Optional[float]]:
    where, expected = place_of_line(path, number), "expected 'id stamp exposure_ms'"
    words = line.split()
    if len(words) not in (2, 3):
        raise InputError(f"{where}: {len(words)} words; {expected}")
    try:
        stamp = parse_stamp(words[1])
        exposure_ms = float(words[2]) if len(words) == 3 else 0.0
    except ValueError as error:
        raise InputError(f"{where}: {error}; {expected}") from error
    if not 0.0 <= exposure_ms < math.inf:
        raise InputError(f"{where}: the exposure {words[2]} is impossible; it is in milliseconds, 0 when unknown")
    return where, _image_id(words[0]), stamp, exposure_ms or None


def _read_encoders(path: Path) -> WheelSamples:
    numbers, ticks = array("q"), array("q")  # compact: there may be millions of lines
    stamps: List[Decimal] = []
    for number, text in read_table(path):
        if not stamps and text.replace(" ", "") == "stamp,left,right":
            continue
        stamp, counters = _parse_ticks(text, path, number)
        numbers.append(number)
        stamps.append(stamp)
        ticks.extend(counters)
    if not stamps:
        raise InputError(f"{path}: there are no ticks in it; delete the file or write lines of 'stamp,left,right'")
    stamps_ns = np.array(increasing_stamps(path, numbers, stamps), np.int64)
    return WheelSamples(WheelUnit.TICKS, stamps_ns, np.array(ticks, np.int64).reshape(-1, 2), str(path))


def _parse_ticks(line: str, path: Path, number: int) -> Tuple[Decimal, Tuple[int, int]]:
    try:
        stamp, left, right = line.split(",")
        return parse_stamp(stamp.strip()), (_int64(left), _int64(right))
    except ValueError:
        where = place_of_line(path, number)
        raise InputError(f"{where}: '{line}'; expected 'stamp,left,right', ticks as whole numbers") from None


def _int64(text: str) -> int:
    number = int(text)
    if not -(2**63) <= number < 2**63:
        raise ValueError(f"{text} is too large")
    return number
