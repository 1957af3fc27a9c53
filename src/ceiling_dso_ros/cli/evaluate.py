# SPDX-License-Identifier: BSD-3-Clause
"""`evaluate`: the error of a run's trajectories against a reference."""

import argparse
import json
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Dict, List, Mapping, Sequence, Set, Tuple

from ceiling_dso_ros.cli.evaluation_references import (
    OF_THE_BASE,
    add_reference_options,
    base_reference,
    camera_reference,
    read_reference_sigma,
    reference_of,
)
from ceiling_dso_ros.cli.outputs import require_output_folder
from ceiling_dso_ros.cli.recording_options import warn
from ceiling_dso_ros.io.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from ceiling_dso_ros.evaluation.reference_sigma import ReferencePart
    from ceiling_dso_ros.evaluation.report import TrajectoryEvaluation
    from ceiling_dso_ros.evaluation.time_offset import TimeOffset
    from ceiling_dso_ros.io.trajectory import Trajectory

# File -> alignment. The camera alone has no metric scale; trajectories with wheels are metric and planar.
TRAJECTORIES = {
    "camera": "sim3",
    "camera_final": "sim3",
    "camera_metric": "se3",
    "wheel": "se2",
    "fused": "se2",
    "fused_smoothed": "se2",
    "mapped": "se2",
}
NUMBERS = "evaluation.json"
OTHER_BODY_DEG = 15.0  # by more no frame differs from the same one elsewhere, as by a mount that is not quite upright
FARTHEST_S = 4 * 10**9  # from a clock that begins with zero to that of any computer


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "evaluate",
        help="compare a run with a reference trajectory",
        description="Compare DIR/*.tum with a reference; print the errors, write evaluation.json and figures to DIR.",
    )
    parser.add_argument("directory", metavar="DIR", type=Path, help="folder written by `run --out`")
    add_reference_options(parser)
    parser.add_argument(
        "--align",
        choices=("auto", "sim3", "se3", "se2", "sim2"),
        default="auto",
        help="alignment before the comparison; auto (default): sim3 for the camera's trajectories, se2 for metric ones",
    )
    parser.add_argument(
        "--max-difference",
        metavar="S",
        type=_seconds,
        default=0.01,
        help="largest time difference of two matched poses, seconds (default %(default)s)",
    )
    parser.add_argument(
        "--interpolate",
        action="store_true",
        help="interpolate the reference at the stamps of the estimate instead of using its nearest poses",
    )
    parser.add_argument(
        "--time-offset",
        metavar="S",
        type=_offset_ns,
        help="seconds that are added to the stamps of DIR/*.tum: "
        "positive if the reference is stamped too late, negative if too "
        "early (default: 0, and the offset is estimated and reported)",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for evaluation.json and figures (default: DIR)")
    parser.set_defaults(execute=execute)


def execute(options: argparse.Namespace) -> None:
    """Evaluate every trajectory there is; what cannot be compared is said and left out.

    Raises:
        InputError: missing or unreadable files, no trajectory that can be compared, or an unwritable folder.
        OutputError: some files cannot be written; the others are, and the errors are printed.
    """
    from ceiling_dso_ros.evaluation.figures import FILES, figure_writers
    from ceiling_dso_ros.evaluation.reference_sigma import reference_part
    from ceiling_dso_ros.evaluation.report import tables
    from ceiling_dso_ros.evaluation.time_offset import estimate_time_offset
    from ceiling_dso_ros.io.replacing import replace_file, write_each
    from ceiling_dso_ros.io.stamps import NANOSECONDS
    from ceiling_dso_ros.io.trajectory import read_tum

    trajectories = _find_trajectories(options.directory)
    out = options.out or options.directory
    require_output_folder(out, [NUMBERS, *FILES])
    sigma = read_reference_sigma(options)
    warnings: List[str] = []

    def tell(text: str) -> None:
        warnings.append(text)
        warn(text)

    references = {
        path: read_tum(path, tell) for path in {camera_reference(options): None, base_reference(options): None}
    }
    estimates: Dict[str, Trajectory] = {}
    evaluations: List[TrajectoryEvaluation] = []
    left_out: Dict[str, InputError] = {}
    for name, path in trajectories.items():
        try:
            estimate = read_tum(path, tell).shifted(options.time_offset or 0)
            evaluations.append(_evaluate(name, estimate, references, options))
            estimates[name] = estimate
        except InputError as error:
            left_out[name] = error
    if not evaluations:
        raise next(iter(left_out.values()))
    for reason in left_out.values():
        tell(f"{reason}; left out")
    offsets = {
        name: estimate_time_offset(estimate, references[reference_of(name, options)])
        for name, estimate in estimates.items()
    }
    _warn_of_offsets(offsets, options, tell)
    _warn_of_bodies(evaluations, options, tell)
    parts = [] if sigma is None else [reference_part(each, sigma) for each in evaluations]
    numbers = {
        "reference": str(camera_reference(options)),
        "base_reference": str(base_reference(options)),
        "max_difference_s": options.max_difference,
        "interpolated": options.interpolate,
        "time_offset_s": (options.time_offset or 0) / NANOSECONDS,
        "trajectories": {each.name: each.numbers() for each in evaluations},
        "reference_sigma": {part.name: part.numbers() for part in parts},
        "time_offsets": {name: offset.numbers() for name, offset in offsets.items()},
        "left_out": {name: str(reason) for name, reason in left_out.items()},
        "warnings": warnings,
    }
    content = (json.dumps(numbers, indent=2, allow_nan=False) + "\n").encode()
    figures = figure_writers(_drawn(estimates, references, options), evaluations)
    try:
        write_each(out, {NUMBERS: lambda path: replace_file(path, content, "the numbers"), **figures})
    finally:
        print(tables(evaluations, _doubtful_lengths(parts)))
        _print_details(evaluations, offsets, options)
        for line in _of_the_reference(parts):
            print(line)


def _evaluate(
    name: str, estimate: "Trajectory", references: Dict[Path, "Trajectory"], options: argparse.Namespace
) -> "TrajectoryEvaluation":
    from ceiling_dso_ros.evaluation.alignment import AlignmentKind
    from ceiling_dso_ros.evaluation.report import EvaluationError, evaluate_trajectory

    path = reference_of(name, options)
    kind = AlignmentKind(TRAJECTORIES[name] if options.align == "auto" else options.align)
    try:
        return evaluate_trajectory(name, estimate, references[path], kind, options.max_difference, options.interpolate)
    except EvaluationError as error:
        advice = _advice(estimate, references[path], options)
        raise InputError(f"{options.directory / name}.tum against {path}: {error}{advice}") from error


def _advice(estimate: "Trajectory", reference: "Trajectory", options: argparse.Namespace) -> str:
    """What to do if two trajectories have no pairs because one is stamped late; empty if that is not known."""
    from ceiling_dso_ros.evaluation.time_offset import estimate_time_offset

    offset = estimate_time_offset(estimate, reference)
    if not offset.significant:
        return ""
    direction = "later" if offset.value_s > 0 else "earlier"
    return f", or give {_correction(offset, options)}: the reference is stamped {direction} ({offset})"


def _correction(offset: "TimeOffset", options: argparse.Namespace) -> str:
    """The option that corrects an offset, which was found after what it has corrected already."""
    from ceiling_dso_ros.io.stamps import NANOSECONDS

    return f"--time-offset {(options.time_offset or 0) / NANOSECONDS + offset.value_s:.3f}"


def _warn_of_offsets(
    offsets: Mapping[str, "TimeOffset"], options: argparse.Namespace, tell: Callable[[str], None]
) -> None:
    """One line for each reference whose clock is not that of the trajectories."""
    for path in {reference_of(name, options): None for name in offsets}:
        found = {
            name: offset
            for name, offset in offsets.items()
            if offset.significant and reference_of(name, options) == path
        }
        if found:
            best = min(found.values(), key=lambda offset: offset.sigma_s)
            right = _correction(best, options)
            tell(
                f"{path}: is stamped {'later' if best.value_s > 0 else 'earlier'} than "
                f"{', '.join(f'{name} ({offset})' for name, offset in found.items())}; "
                + (f"nothing is corrected without {right}" if options.time_offset is None else f"give {right} instead")
            )


def _warn_of_bodies(
    evaluations: Sequence["TrajectoryEvaluation"], options: argparse.Namespace, tell: Callable[[str], None]
) -> None:
    """One line for each reference that seems to be of another body than the trajectories."""
    turned: Dict[Path, List[TrajectoryEvaluation]] = {}
    for each in evaluations:
        if each.body_rotation_deg is not None and each.body_rotation_deg > OTHER_BODY_DEG:
            turned.setdefault(reference_of(each.name, options), []).append(each)
    for path, found in turned.items():
        named = ", ".join(f"{each.name} ({each.body_rotation_deg:.0f} degrees)" for each in found)
        of_base = found[0].name in OF_THE_BASE
        advice = "--base-reference a trajectory of base_link" if of_base else "--reference a trajectory of the camera"
        tell(f"{path}: is of another body than {named}, turned by that all the way; give {advice}")


def _print_details(
    evaluations: Sequence["TrajectoryEvaluation"], offsets: Mapping[str, "TimeOffset"], options: argparse.Namespace
) -> None:
    for each in evaluations:
        for line in each.coverage.describe(each.name, options.max_difference):
            print(line)
    for name, offset in offsets.items():
        print(f"{name}: time offset of the reference {'not known: ' if offset.unknown else ''}{offset}")
    names: Dict[Path, List[str]] = {}
    for each in evaluations:
        names.setdefault(reference_of(each.name, options), []).append(each.name)
    for path, compared in names.items():
        print(f"{', '.join(compared)}: against {path}")


def _doubtful_lengths(parts: Sequence["ReferencePart"]) -> Set[Tuple[str, float]]:
    """Name and length of the relative errors for which the reference is not good enough."""
    return {(part.name, each.length_m) for part in parts for each in part.relative if not each.good_enough}


def _of_the_reference(parts: Sequence["ReferencePart"]) -> List[str]:
    """How sure the reference is, and which trajectories it tells apart."""
    from ceiling_dso_ros.evaluation.reference_sigma import ranking

    lines = [line for part in parts for line in part.describe()]
    for body in (True, False):
        ranks = ranking([part for part in parts if (part.name in OF_THE_BASE) == body])
        if sum(map(len, ranks)) > 1:
            text = " < ".join(" = ".join(rank) for rank in ranks)
            lines.append(f"ATE, the best first: {text} (=: the reference does not tell them apart)")
    return lines


def _drawn(
    estimates: Mapping[str, "Trajectory"], references: Mapping[Path, "Trajectory"], options: argparse.Namespace
) -> List["np.ndarray"]:
    """Positions of each reference that is used, within the time of the estimates, (M, 3)."""
    start_ns = min(estimate.stamps_ns[0] for estimate in estimates.values())
    end_ns = max(estimate.stamps_ns[-1] for estimate in estimates.values())
    used = [references[path] for path in {reference_of(name, options): None for name in estimates}]
    return [each.positions[(each.stamps_ns >= start_ns) & (each.stamps_ns <= end_ns)] for each in used]


def _find_trajectories(directory: Path) -> Dict[str, Path]:
    paths = {name: directory / f"{name}.tum" for name in TRAJECTORIES}
    found = {name: path for name, path in paths.items() if path.exists()}
    if not found:
        raise InputError(
            f"{directory}: there is no camera.tum or other trajectory of a run in it; give the folder of `run --out`"
        )
    return found


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number of seconds")
    return value


def _offset_ns(text: str) -> int:
    """Exact nanoseconds: an offset may be that of a clock that begins with zero to today's."""
    from ceiling_dso_ros.io.stamps import NANOSECONDS

    try:
        value = Decimal(text)
    except InvalidOperation:
        value = Decimal("nan")
    if not (value.is_finite() and abs(value) <= FARTHEST_S):
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds between -{FARTHEST_S} and {FARTHEST_S}")
    return int((value * NANOSECONDS).to_integral_value())
