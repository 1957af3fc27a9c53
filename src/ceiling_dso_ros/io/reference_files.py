# SPDX-License-Identifier: BSD-3-Clause
"""A reference is one file for all trajectories, or two: beside GT.tum, GT_camera.tum or GT_base.tum."""

from pathlib import Path


def reference_of_camera(reference: Path) -> Path:
    """`GT_camera.tum` beside the reference `GT.tum` if it exists, else the reference itself."""
    beside = reference.with_name(f"{reference.stem}_camera.tum")
    return beside if beside.exists() else reference


def reference_of_base(reference: Path) -> Path:
    """`GT_base.tum` beside the reference `GT.tum` if it exists, else the reference itself."""
    beside = reference.with_name(f"{reference.stem}_base.tum")
    return beside if beside.exists() else reference
