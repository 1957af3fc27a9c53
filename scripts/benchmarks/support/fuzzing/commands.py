# SPDX-License-Identifier: BSD-3-Clause
"""Targets that are commands, as a user calls them, in this process: exit code 0, or one line that begins with error."""

import contextlib
import io
import random as randoms
import shutil
from pathlib import Path
from random import Random
from typing import Callable, List, Optional, Sequence
from unittest import mock

import cv2
from support.fuzzing import bags, mutations
from support.fuzzing.files import ENCODERS, POSES, RESPONSE, ROBOT
from support.fuzzing.messages import mutated_message, serialised
from support.fuzzing.recordings import drive_messages, picture, write_folder
from support.fuzzing.rules import (
    REFUSED,
    USED,
    BrokenRuleError,
    outcome_of,
    require_clear_line,
    require_finite_files,
)
from support.fuzzing.runner import Case, Target

from ceiling_dso_ros.cli.main import DONE, FAILED, WRONG_INPUT, main
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.simulation.events import EventError, parse_events

SIZE = (192, 160)  # the smallest that can be tracked, nearly
IMAGES = 6
CAMERA = f"Pinhole 120 120 95.5 79.5 0\n{SIZE[0]} {SIZE[1]}\nnone\n{SIZE[0]} {SIZE[1]}\n"
SETTINGS = (
    *("window.max_keyframes=5", "window.candidate_points=300", "tracking.patience=0.5", "fusion.graph.window=12"),
    *("fusion.output.blend_s=0.2", "fusion.scale.ceiling_height_m=4", "window={max_keyframes: 4}"),
)
OPTIONS = ("--fps", "--size", "--bits", "--left-joint", "--base-frame", "--image-topic", "--max-difference", "--align")
EVENTS = ("cover@5+2", "slip", "lights_off@3,lights_on@7", "flicker@2+5", "drop_frames")


def targets(folder: Path) -> List[Target]:
    """All of them; they read from and write to a folder."""
    recording, out = folder / "recording", folder / "out"
    write_folder(recording, [CAMERA], RESPONSE, ROBOT, ENCODERS, POSES)
    (recording / "vignette.png").unlink()
    shutil.rmtree(recording / "images")
    (recording / "images").mkdir()
    for index in range(IMAGES):
        cv2.imwrite(str(recording / "images" / f"{index:05d}.png"), picture(index, *SIZE))
    (recording / "times.txt").write_text("".join(f"{i} 1700000001.{33 * i:03d} 5\n" for i in range(IMAGES)))
    (folder / "compared").mkdir()
    for name in ("camera", "camera_final", "fused", "reference"):
        (folder / "compared" / f"{name}.tum").write_text(POSES)
    of_recording = sorted(path for path in recording.iterdir() if path.is_file())
    of_comparison = sorted((folder / "compared").iterdir())
    return [
        Target("evaluate", 400, lambda: _command(of_comparison, lambda r: _evaluate(r, folder / "compared"), out)),
        Target("run", 250, lambda: _command(of_recording, lambda r: _run(r, recording, out), out)),
        Target("calibrate", 60, lambda: _command(of_recording, lambda r: _calibrate(recording, out), out)),
        Target("collect", 300, lambda: _collect(folder / "collected.bag", out)),
        Target("command line", 400, lambda: _usage),
        Target("events", 500, lambda: _events),
    ]


def _command(originals: Sequence[Path], words: Callable[[Random], List[str]], out: Path) -> Callable[[Random], Case]:
    """A command that reads files, one of which is changed."""
    contents = {path: path.read_bytes() for path in originals}

    def make(random: Random) -> Case:
        path = random.choice(originals)
        content = mutations.mutated_text_bytes(random, contents[path].decode())
        given = words(random)

        def act() -> str:
            path.write_bytes(content)
            try:
                return _called(given, out)
            finally:
                path.write_bytes(contents[path])

        return (given, path.name, content), act

    return make


def _evaluate(random: Random, folder: Path) -> List[str]:
    words = ["evaluate", str(folder), "--reference", str(folder / "reference.tum")]
    words += ["--align", random.choice(("auto", "sim3", "se3", "se2", "sim2"))]
    words += ["--interpolate"] * random.randrange(2)
    return [*words, "--max-difference", random.choice(("0.01", "1e-9", "0.2", "1e9", "nan", "x"))]


def _run(random: Random, recording: Path, out: Path) -> List[str]:
    words = ["run", str(recording), "--out", str(out)]
    for option, values in (
        ("--fps", ("10", "0.001", "1e300", "-1", "nan")),
        ("--size", ("176x144", "96x80", "0x0", "1x1", "99999x99999", "x")),
        ("--bits", ("8", "0", "16", "-3", "99")),
        ("--set", tuple(mutations.mutated_text(random, each, most=1) for each in SETTINGS)),
    ):
        if not random.randrange(4):
            words.append(f"{option}={random.choice(values)}")
    return [*words, *["--no-prediction"] * random.randrange(2)]


def _calibrate(recording: Path, out: Path) -> List[str]:
    return ["calibrate", str(recording), "--out", str(out / "robot.yaml")]


def _collect(path: Path, out: Path) -> Callable[[Random], Case]:
    messages = [each for each in drive_messages().all if each[0] in bags.TRAJECTORIES.values()]

    def make(random: Random) -> Case:
        changed = list(messages)
        for _ in range(1 + random.randrange(3)):
            at = random.randrange(len(changed))
            topic, stamp_ns, message = changed[at]
            changed[at] = topic, stamp_ns, mutated_message(random, message)

        def act() -> str:
            records = [(topic, stamp_ns, each.__msgtype__, serialised(each)) for topic, stamp_ns, each in changed]
            bags.write_bag(path, records, None)
            return _called(["collect", str(path), "--out", str(out)], out)

        return [each for each, before in zip(changed, messages) if each is not before], act

    return make


def _usage(random: Random) -> Case:
    """Wrong words of a command, none of which names a file that is there."""
    words = [
        random.choice(("run", "evaluate", "collect", "calibrate", "benchmark", "simulate", mutations.text(random)))
    ]
    for _ in range(random.randrange(5)):
        words.append(random.choice((*OPTIONS, "no-such-file", repr(mutations.number(random)), mutations.text(random))))
    words = [word for word in words if "/" not in word and word != "-"]
    return words, lambda: _called([*words, "--no-such-option"], None)


def _events(random: Random) -> Case:
    texts = [mutations.mutated_text(random, random.choice(EVENTS), most=2) for _ in range(1 + random.randrange(3))]

    def read() -> object:
        try:
            return parse_events(texts, 60.0)
        except EventError as error:
            raise InputError(str(error)) from error

    return texts, lambda: outcome_of(read)


def _called(words: List[str], out: Optional[Path]) -> str:
    """Call a command with an empty output folder."""
    if out is not None:
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
    said = io.StringIO()
    # Figures take a second, and are those of the numbers; one in ten is drawn. Kernels are loaded already.
    draws = not randoms.Random(repr(words)).randrange(10)
    none = mock.patch("ceiling_dso_ros.evaluation.figures.figure_writers", return_value={})
    figures = contextlib.nullcontext() if draws else none
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said), figures, mock.patch(
        "ceiling_dso_ros.dso.warmup.load_kernels"
    ):
        try:
            code = main(words)
        except SystemExit as end:  # of the parser
            code = int(end.code or 0)
    lines = [line for line in said.getvalue().splitlines() if not line.startswith(("frame", " "))]
    for line in lines:
        if line.startswith(("error: ", "warning: ")):
            require_clear_line(line)
    errors = [line for line in lines if line.startswith("error: ")]
    if code not in (DONE, FAILED, WRONG_INPUT) or len(errors) != int(code != DONE):
        raise BrokenRuleError(f"exit code {code} with {said.getvalue()[:1000]!r}")
    if out is not None:
        require_finite_files(out)
    return USED if code == DONE else REFUSED
