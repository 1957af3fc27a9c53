# SPDX-License-Identifier: BSD-3-Clause
"""Makes trajectories of what a node has kept on the disk.

What needs no computing is copied. While a node runs, all of it is done in a process of its own, `python3 -m
ceiling_dso_ros.playback.spool_files SPOOL DIR`: the arrays and the lines of a whole drive would keep the node's other
threads from running for longer than a robot may wait for its pose.
"""

import itertools
import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, Callable, Dict, List, Mapping, Optional, Sequence

from ceiling_dso_ros.io.errors import InputError, OutputError, reason_of
from ceiling_dso_ros.io.replacing import replacing, write_each
from ceiling_dso_ros.io.rolling_file import read_rolling
from ceiling_dso_ros.playback.spool_records import Tell, read_pose_lines

# From a spool into a file; is told what is left out, and returns the number of poses.
Writer = Callable[[Path, BinaryIO, Tell], int]
# Files of a node, the first one as it is kept.
OF_FUSION = ("fused.tum", "wheel.tum", "fused_smoothed.tum")
OF_CAMERA = ("camera.tum", "keyframes.tum", "camera_final.tum")
NICENESS = 19  # of the process, the largest: nodes come first


@dataclass
class Written:
    """What became of files.

    Attributes:
        poses: name of a file that was written -> number of its poses.
        errors: a line for each of the others, and for what else is wrong.
    """

    poses: Dict[str, int] = field(default_factory=dict)
    errors: List[str] = field(default_factory=list)

    def tell(self, error: str) -> None:
        """Add an error, once."""
        if error not in self.errors:
            self.errors.append(error)

    def __str__(self) -> str:
        return ", ".join(f"{name} ({count} poses)" for name, count in self.poses.items())


def is_spool(folder: Path) -> bool:
    """Whether a node has kept results in a folder."""
    return folder.suffix == ".spool" and os.path.isdir(folder)  # noqa: PTH112  # Path raises if a name is too long


def require_outside_spools(folder: Path) -> None:
    """Refuse to write where nodes keep their results: open files would be replaced, and all is removed in the end.

    Raises:
        InputError: a folder, which need not exist, is that of a node, or within it.
    """
    resolved = Path(os.path.realpath(folder))
    for parent in (resolved, *resolved.parents):
        if is_spool(parent):
            raise InputError(f"{folder}: a node keeps its results in {parent}; choose a folder outside of it")


def write_all(spool: Path, directory: Path) -> Written:
    """Write all trajectories of a spool, each whole or not at all, into an existing folder."""
    written = write_copies(spool, directory)
    computed = write_computed(spool, directory)
    return Written({**written.poses, **computed.poses}, [*written.errors, *computed.errors])


def set_aside(spool: Path, directory: Path) -> Optional[Path]:
    """Move what another run of the node has written to a folder of its own, so that it is not replaced.

    Args:
        spool: of the present run.
        directory: that will be written to.

    Returns:
        The folder, DIRECTORY/before.N; None if there is nothing of another run.

    Raises:
        OutputError: it cannot be moved.
    """
    names = OF_FUSION if _is_of_fusion(spool) else OF_CAMERA
    written = directory / names[0]
    if not written.is_file() or _first_line(written) == _first_line(spool / names[0]):
        return None
    numbered = (directory / f"before.{number}" for number in itertools.count(1))
    folder = next(folder for folder in numbered if not any((folder / name).exists() for name in names))
    try:
        folder.mkdir(exist_ok=True)
        for name in names:
            if (directory / name).is_file():
                (directory / name).rename(folder / name)
    except OSError as error:
        reason = f"cannot move the trajectories of an earlier run there: {reason_of(error)}"
        raise OutputError(f"{folder}: {reason}") from error
    return folder


def _first_line(path: Path) -> bytes:
    """Of a file that may be rolling; of two runs, it differs."""
    return next(read_rolling(path), b"").split(b"\n")[0]


def write_copies(spool: Path, directory: Path) -> Written:
    """Write those that a spool contains as they are."""
    names = ("wheel.tum", "fused.tum") if _is_of_fusion(spool) else ("camera.tum",)
    return _write(spool, directory, {name: _copier(name) for name in names})


def write_computed(spool: Path, directory: Path) -> Written:
    """Write those that are computed from a spool."""
    # not needed by a node, and slow to import
    from ceiling_dso_ros.playback.camera_spool import write_final, write_keyframes
    from ceiling_dso_ros.playback.fusion_spool import write_smoothed

    if _is_of_fusion(spool):
        return _write(spool, directory, {"fused_smoothed.tum": write_smoothed})
    return _write(spool, directory, {"keyframes.tum": write_keyframes, "camera_final.tum": write_final})


def write_all_apart(spool: Path, directory: Path) -> Written:
    """The same as `write_all` in a process of its own; if that fails, what can be copied is still written."""
    command = [sys.executable, "-m", __name__, str(spool), str(directory)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        run = subprocess.run(
            command, env=environment, capture_output=True, text=True, start_new_session=True, check=True
        )
        return Written(**json.loads(run.stdout))
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip().splitlines() or [f"exit code {error.returncode}"])[-1]
    except (OSError, ValueError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else str(error)
    copied = write_copies(spool, directory)
    return Written(copied.poses, [*copied.errors, f"{spool}: no trajectories could be computed: {reason}"])


def _is_of_fusion(spool: Path) -> bool:
    return (spool / "fusion.yaml").exists()


def _write(spool: Path, directory: Path, writers: Mapping[str, Writer]) -> Written:
    written = Written()

    def write(path: Path) -> None:
        with replacing(path, "the trajectory") as file:
            count = writers[path.name](spool, file, written.tell)
        written.poses[path.name] = count

    try:
        write_each(directory, dict.fromkeys(writers, write))
    except OutputError as error:
        written.errors += error.lines
    return written


def _copier(name: str) -> Writer:
    def copy(spool: Path, file: BinaryIO, tell: Tell) -> int:
        count = 0
        for lines in read_pose_lines(spool / name, tell):
            file.write(lines)
            count += lines.count(b"\n")
        return count

    return copy


def main(arguments: Sequence[str]) -> int:
    """Entry point of the process."""
    spool, directory = map(Path, arguments)
    os.nice(NICENESS)
    written = write_all(spool, directory)
    print(json.dumps({"poses": written.poses, "errors": written.errors}))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
