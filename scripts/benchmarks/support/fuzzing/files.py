# SPDX-License-Identifier: BSD-3-Clause
"""Targets that read files: settings, calibrations, trajectories, folders, images, and what nodes keep on the disk."""

import shutil
import zipfile
from functools import partial
from pathlib import Path
from random import Random
from typing import Callable, Dict, List, Sequence, Tuple

import cv2
import numpy as np
from support.fuzzing import mutations
from support.fuzzing.recordings import (
    HEIGHT,
    WIDTH,
    picture,
    read_all,
    write_camera_spool,
    write_folder,
    write_fusion_spool,
)
from support.fuzzing.rules import USED, outcome_of, require_finite_files
from support.fuzzing.runner import Case, Target

from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.camera_models import read_camera_file
from ceiling_dso_ros.io.image_decoding import decode_compressed, decode_image
from ceiling_dso_ros.io.image_encodings import ENCODINGS
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.photometric import read_photometric
from ceiling_dso_ros.io.robot_file import read_robot_file
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.io.undistortion import undistortion_maps
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.playback.spool_files import write_all
from ceiling_dso_ros.settings import load_settings, plain_values

CAMERAS = (
    f"Pinhole 60 61 47.5 39.5 0\n{WIDTH} {HEIGHT}\nnone\n{WIDTH} {HEIGHT}\n",
    f"Pinhole 0.6 0.7 0.5 0.5 0\n{WIDTH} {HEIGHT}\nfull\n{WIDTH} {HEIGHT}\n",
    f"RadTan 60 61 47.5 39.5 -0.1 0.02 0.001 -0.001\n{WIDTH} {HEIGHT}\ncrop\n{WIDTH} {HEIGHT}\n",
    f"EquiDistant 60 61 47.5 39.5 -0.01 0.02 0.001 -0.001\n{WIDTH} {HEIGHT}\nfull\n{WIDTH} {HEIGHT}\n",
    f"FOV 0.6 0.7 0.5 0.5 0.9\n{WIDTH} {HEIGHT}\n0.4 0.5 0.5 0.5 0\n{WIDTH} {HEIGHT}\n",
)
RESPONSE = " ".join(f"{value**1.2:.3f}" for value in range(256)) + "\n"
ROBOT = """ticks_per_turn: 4096
wheel_radius: [0.098, 0.099]
wheel_base: 0.485
T_base_camera:
  xyz: [0.18, 0.04, 0.62]
  quat_xyzw: [0, 0, 0.6, 0.8]
camera_time_offset: 0.01
"""
POSES = "# stamp tx ty tz qx qy qz qw\n" + "".join(
    f"{1_700_000_001 + 0.1 * index:.3f} {0.1 * index} {index % 3} 0 0 0 0.6 0.8\n" for index in range(8)
)
ENCODERS = "stamp,left,right\n" + "".join(
    f"1700000001.{20 * index:03d},{10 * index},{9 * index}\n" for index in range(12)
)


def targets(folder: Path) -> List[Target]:
    """All of them; they write to a folder."""
    return [
        _of_text("camera.txt", 1500, folder, CAMERAS, _use_camera),
        _of_text("pcalib.txt", 500, folder, [RESPONSE], lambda path: read_photometric(path, None, (WIDTH, HEIGHT))),
        _of_bytes("vignette.png", 500, folder, _pictures((".png",)), _use_vignette),
        _of_text("robot.yaml", 1500, folder, [ROBOT], lambda path: robot_model(read_robot_file(path))),
        _of_text("dso.yaml", 1000, folder, [_yaml(OdometryConfig())], partial(load_settings, kind=OdometryConfig)),
        _of_text("fusion.yaml", 1000, folder, [_yaml(FusionConfig())], partial(load_settings, kind=FusionConfig)),
        Target("--set", 500, lambda: _overrides),
        _of_text("trajectory.tum", 1500, folder, [POSES], read_tum),
        _of_folder("folder, text files", 1500, folder / "texts"),
        _of_folder("folder, images", 500, folder / "images"),
        _of_folder("folder, images.zip", 700, folder / "zip"),
        Target("image file", 2000, lambda: _image_file),
        Target("image message", 2000, lambda: _image_message),
        _of_spool("camera's spool", 400, folder / "camera", write_camera_spool),
        _of_spool("fusion's spool", 400, folder / "fusion", write_fusion_spool),
    ]


def _yaml(config: object) -> str:
    import yaml

    return str(yaml.safe_dump(plain_values(config), sort_keys=False))


def _of_text(name: str, count: int, folder: Path, originals: Sequence[str], use: Callable[[Path], object]) -> Target:
    path = folder / name

    def make(random: Random) -> Case:
        content = mutations.mutated_text_bytes(random, random.choice(originals))

        def act() -> str:
            path.write_bytes(content)
            return outcome_of(lambda: use(path))

        return content, act

    return Target(name, count, lambda: make)


def _of_bytes(name: str, count: int, folder: Path, originals: List[bytes], use: Callable[[Path], object]) -> Target:
    path = folder / name

    def make(random: Random) -> Case:
        content = mutations.mutated_bytes(random, random.choice(originals))

        def act() -> str:
            path.write_bytes(content)
            return outcome_of(lambda: use(path))

        return content, act

    return Target(name, count, lambda: make)


def _use_camera(path: Path) -> object:
    calibration = read_camera_file(path)
    return calibration, undistortion_maps(calibration), calibration.lens.max_radius


def _use_vignette(path: Path) -> object:
    pixels = picture()[:24, :32]  # as `_pictures`
    return read_photometric(None, path, (32, 24)).correct(pixels)


def _overrides(random: Random) -> Case:
    known = ("window.max_keyframes=5", "tracking.patience=1.0", "selection.density=0.3", "window={max_keyframes: 4}")
    given = [mutations.mutated_text(random, random.choice(known)) for _ in range(1 + random.randrange(2))]
    return given, lambda: outcome_of(lambda: load_settings(None, given))


def _pictures(endings: Tuple[str, ...]) -> List[bytes]:
    pixels = picture()[:24, :32]
    pictures = []
    for ending in endings:
        kinds = (pixels, pixels.astype(np.uint16) * 200) if ending in (".png", ".tif", ".pgm") else (pixels,)
        pictures += [cv2.imencode(ending, kind)[1].tobytes() for kind in kinds]
    colours = np.dstack([pixels, pixels[::-1], pixels])
    return pictures + [cv2.imencode(ending, colours)[1].tobytes() for ending in endings if ending != ".pgm"]


def _image_file(random: Random) -> Case:
    content = mutations.mutated_bytes(random, random.choice(IMAGE_FILES))
    image_format = random.choice(("", "jpeg", "bayer_rggb8; png compressed ", "mono16; png compressed ", "bayer_xxxx8"))
    return (image_format, content), lambda: outcome_of(lambda: decode_compressed(content, image_format))


def _image_message(random: Random) -> Case:
    encoding = random.choice((*ENCODINGS, *ENCODINGS, mutations.text(random)))
    width, height = (random.choice((0, 1, 2, 3, 17, 32, 60_000, 2**32 - 1)) for _ in range(2))
    value, channels, _ = ENCODINGS.get(encoding, ("u1", 1, None))
    row = min(width, 64) * channels * int(value[1:])
    step = random.choice((row, row, row, row + 3, 0, 1, 2**32 - 1))
    size = random.choice((step * height, step * height, step * height - 1, 0, 100))
    data = random.randrange(2**32).to_bytes(4, "little") * (min(max(size, 0), 2**16) // 4 + 1)
    data = data[: max(size, 0)]
    fields = (encoding, height, width, step, bool(random.randrange(2)), data)
    calibration_size = (width, height) == (32, 32)
    return fields, lambda: outcome_of(lambda: (decode_image(*fields), calibration_size))


def _of_folder(name: str, count: int, folder: Path) -> Target:
    """Whole recordings with one changed file, of the kind that the name says."""
    write_folder(folder, CAMERAS, RESPONSE, ROBOT, ENCODERS, POSES)
    if "zip" in name:
        with zipfile.ZipFile(folder / "images.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted((folder / "images").iterdir()):
                archive.write(path, path.name)
        shutil.rmtree(folder / "images")
    endings = {"folder, text files": (".txt", ".csv", ".yaml"), "folder, images": (".png", ".jpg")}.get(name, (".zip",))
    originals: Dict[Path, bytes] = {
        path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.suffix in endings
    }

    def make(random: Random) -> Case:
        path = random.choice(list(originals))
        if path.suffix in (".txt", ".csv", ".yaml"):
            content = mutations.mutated_text_bytes(random, originals[path].decode())
        else:
            content = mutations.mutated_bytes(random, originals[path])

        def act() -> str:
            path.write_bytes(content)
            try:
                return outcome_of(lambda: read_all(open_recording(folder)))
            finally:
                path.write_bytes(originals[path])

        return (path.name, content), act

    return Target(name, count, lambda: make)


def _of_spool(name: str, count: int, folder: Path, write: Callable[[Path], Path]) -> Target:
    folder.mkdir()
    spool, out = write(folder), folder / "out"
    out.mkdir()
    originals = {path: path.read_bytes() for path in sorted(spool.iterdir()) if path.stat().st_size}

    def make(random: Random) -> Case:
        path = random.choice(list(originals))
        if path.suffix in (".yaml", ".tum") and random.randrange(2):
            content = mutations.mutated_text_bytes(random, originals[path].decode())
        elif random.randrange(4):
            content = mutations.mutated_bytes(random, originals[path])
        else:  # as a loss of power leaves it
            kept = random.randrange(len(originals[path]))
            content = originals[path][:kept] + bytes(len(originals[path]) - kept)

        def act() -> str:
            path.write_bytes(content)
            try:
                written = write_all(spool, out)
                for error in written.errors:
                    _require_foreseen(error)
                require_finite_files(out)
                return USED
            finally:
                path.write_bytes(originals[path])

        return (path.name, content), act

    return Target(name, count, lambda: make)


def _require_foreseen(error: str) -> None:
    from support.fuzzing.rules import BrokenRuleError, require_clear_line

    require_clear_line(error)
    if "cannot compute" in error:  # what is said of an error of any kind
        raise BrokenRuleError(error)


IMAGE_FILES = _pictures((".png", ".jpg", ".bmp", ".pgm", ".tif"))
