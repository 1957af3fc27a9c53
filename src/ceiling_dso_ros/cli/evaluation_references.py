# SPDX-License-Identifier: BSD-3-Clause
"""Which reference a trajectory is compared with, and how sure that is."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Optional

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.reference_files import reference_of_base, reference_of_camera

if TYPE_CHECKING:
    from ceiling_dso_ros.evaluation.reference_sigma import ReferenceSigma

OF_THE_BASE = ("wheel", "fused", "fused_smoothed", "mapped")
BESIDE = ""  # of --reference-sigma without a value


def add_reference_options(parser: argparse.ArgumentParser) -> None:
    """Add them."""
    parser.add_argument(
        "--reference",
        metavar="GT.tum",
        type=Path,
        required=True,
        help="TUM trajectory of the camera, metres; with GT_camera.tum beside it, GT.tum is that of base_link",
    )
    parser.add_argument(
        "--base-reference",
        metavar="GT.tum",
        type=Path,
        help=f"TUM trajectory of base_link, metres, for {', '.join(f'{name}.tum' for name in OF_THE_BASE)} (default: "
        "GT_base.tum beside --reference GT.tum if it exists, else --reference itself)",
    )
    parser.add_argument(
        "--reference-sigma",
        metavar="M|FILE",
        nargs="?",
        const=BESIDE,
        help="say how sure the reference is beside the errors, and rank nothing that it does not tell apart: its "
        "standard deviation in metres, or a file of `reference` (default: GT.covariance.txt beside the reference)",
    )


def camera_reference(options: argparse.Namespace) -> Path:
    """`GT_camera.tum` beside the reference `GT.tum` if it exists, else the reference itself."""
    return reference_of_camera(options.reference)


def base_reference(options: argparse.Namespace) -> Path:
    """The given file, else `GT_base.tum` beside the reference `GT.tum`, else the reference itself."""
    return options.base_reference or reference_of_base(options.reference)


def reference_of(name: str, options: argparse.Namespace) -> Path:
    """The reference of a trajectory."""
    return base_reference(options) if name in OF_THE_BASE else camera_reference(options)


def read_reference_sigma(options: argparse.Namespace) -> "Optional[ReferenceSigma]":
    """How sure the reference is; None where that was not asked for.

    Raises:
        InputError: neither a number of metres nor a readable file.
    """
    from ceiling_dso_ros.evaluation.reference_sigma import ReferenceSigma
    from ceiling_dso_ros.io.pose_covariances import covariances_path, read_covariances

    text: Optional[str] = options.reference_sigma
    if text is None:
        return None
    if text == BESIDE:
        path = covariances_path(base_reference(options))
        if not path.exists():
            raise InputError(f"{path}: there is no such file; give --reference-sigma a file, or metres such as 0.005")
        return ReferenceSigma.of(read_covariances(path))
    try:
        sigma_m = float(text)
    except ValueError:
        return ReferenceSigma.of(read_covariances(Path(text)))
    if not (math.isfinite(sigma_m) and sigma_m > 0.0):
        raise InputError(f"--reference-sigma {text}: must be a positive number of metres, or a file")
    return ReferenceSigma.constant(sigma_m)
