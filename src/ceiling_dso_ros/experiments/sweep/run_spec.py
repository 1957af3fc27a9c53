# SPDX-License-Identifier: BSD-3-Clause
"""One run of a study: all that its result depends on."""

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

from ceiling_dso_ros import dso, evaluation, fusion, io, playback, settings
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.experiments.source_digest import source_digest
from ceiling_dso_ros.experiments.sweep import conditions, disturbed_recording
from ceiling_dso_ros.experiments.sweep.conditions import Conditions
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.errors import InputError, reason_of
from ceiling_dso_ros.settings import merge_settings, plain_values

LIBRARIES = ("gtsam", "numba", "numpy", "opencv-python-headless", "scipy")
FULL_HZ = 30.0  # of a camera whose images are all used
DIGITS = 16  # of the names of runs and references


@dataclass(frozen=True)
class Opening:
    """How a recording is opened; see `open_recording`.

    Attributes:
        topics: arguments of TopicNames.
        camera, robot: files used instead of the recording's own, None for those.
        rectified: the images are rectified.
        bits: bit depth of 16 bit images, 0 to find it.
    """

    topics: Mapping[str, str] = field(default_factory=dict)
    camera: Optional[str] = None
    robot: Optional[str] = None
    rectified: bool = False
    bits: int = 0


@dataclass(frozen=True)
class RunSpec:
    """One run.

    Attributes:
        sequence: name of the drives that are compared with each other, such as those of one path.
        input: absolute path of the recording.
        reference, base_reference: absolute paths of the true poses of the camera and of base_link, None where unknown.
        opening: how the recording is opened.
        varied: dimension -> its value in this run, as the plan has it.
        conditions, odometry, fusion: all values.
        seed: of the disturbances, and the number of images that are left out at the begin.
    """

    sequence: str
    input: str
    reference: Optional[str]
    base_reference: Optional[str]
    opening: Opening
    varied: Mapping[str, Any]
    conditions: Conditions
    odometry: OdometryConfig
    fusion: FusionConfig
    seed: int

    @property
    def drive(self) -> str:
        """Name of the recording."""
        path = Path(self.input)
        return path.name if path.is_dir() else path.stem

    def work(self) -> float:
        """About how long the run takes, in any unit: by the bytes of the recording and the rate of its images."""
        return min(self.conditions.fps or FULL_HZ, FULL_HZ) * sum(each.stat().st_size for each in files_of(self.input))

    def name(self) -> str:
        """The run's folder: a digest of configuration, contents, seed, and the version of code and libraries.

        Raises:
            InputError: a file cannot be read.
        """
        parts = self.as_json()
        files = {key: content_digest(path) for key, path in self.files().items()}
        for name in ("sequence", "varied", "input", "reference", "base_reference"):
            del parts[name]
        parts["opening"] = {**parts["opening"], "camera": None, "robot": None}
        text = json.dumps([parts, files, code_digest()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]

    def files(self) -> Dict[str, str]:
        """All files and folders that the result depends on."""
        named = {
            "input": self.input, "reference": self.reference, "base_reference": self.base_reference,
            "camera": self.opening.camera, "robot": self.opening.robot or _beside(self.input),
        }  # fmt: skip
        return {name: path for name, path in named.items() if path is not None}

    def as_json(self) -> Dict[str, Any]:
        """As plain values."""
        return {
            **{each.name: getattr(self, each.name) for each in dataclasses.fields(self)},
            "opening": dataclasses.asdict(self.opening),
            "varied": dict(self.varied),
            "conditions": dataclasses.asdict(self.conditions),
            "odometry": plain_values(self.odometry),
            "fusion": plain_values(self.fusion),
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "RunSpec":
        """Back from plain values.

        Raises:
            InputError: a setting has no value of its type.
        """
        kinds: Dict[str, type] = {"conditions": Conditions, "odometry": OdometryConfig, "fusion": FusionConfig}
        configs: Dict[str, Any] = {
            name: merge_settings(kind, [(name, values[name])], name) for name, kind in kinds.items()
        }
        return cls(**{**values, **configs, "opening": Opening(**values["opening"])})


@lru_cache(maxsize=None)
def code_digest() -> str:
    """Of this package's sources that a result depends on, and of the versions of the libraries."""
    libraries = " ".join(f"{name} {version(name)}" for name in LIBRARIES)
    sources = source_digest(dso, fusion, io, playback, settings, evaluation, conditions, disturbed_recording)
    return hashlib.sha256(f"{sources} {libraries}".encode()).hexdigest()


def content_digest(path: str) -> str:
    """SHA-256 of a file, or of the names and contents of all files in a folder.

    Raises:
        InputError: it cannot be read.
    """
    try:
        files = files_of(path)
        return _digest_of(path, tuple((str(each), each.stat().st_size, each.stat().st_mtime_ns) for each in files))
    except OSError as error:
        raise InputError(f"{path}: cannot read it: {reason_of(error)}") from error


def files_of(path: str) -> List[Path]:
    """A file, or all files in a folder."""
    return sorted(each for each in Path(path).rglob("*") if each.is_file()) if Path(path).is_dir() else [Path(path)]


@lru_cache(maxsize=None)
def _digest_of(path: str, files: Tuple[Tuple[str, int, int], ...]) -> str:
    """Computed once for the same sizes and times of change."""
    digest = hashlib.sha256()
    for name, size, _ in files:
        digest.update(f"{Path(name).relative_to(path)} {size} ".encode())
        with Path(name).open("rb") as file:
            for block in iter(lambda: file.read(1 << 20), b""):
                digest.update(block)
    return digest.hexdigest()


def _beside(recording: str) -> Optional[str]:
    """The robot's dimensions beside a bag; those of a folder are in it."""
    path = Path(recording)
    robot = path.with_name(f"{path.stem}.robot.yaml")
    return str(robot) if path.is_file() and robot.is_file() else None
