# SPDX-License-Identifier: BSD-3-Clause
"""Changes of the method for which there is no setting, for the ablation.

Constants are compiled into the kernels, and a change cannot be undone within a process. So each change needs its own
process and its own cache of compiled kernels.
"""

import sys
from typing import Callable, Dict

import numpy as np

from ceiling_dso_ros import dso
from ceiling_dso_ros.dso.adjustment import linearization
from ceiling_dso_ros.dso.config import TrackingConfig
from ceiling_dso_ros.dso.start import initializer as initialization
from ceiling_dso_ros.dso.tracking import tracking_kernels
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeArrays
from ceiling_dso_ros.dso.window.pair_geometry import PairGeometry, pair_geometry


def without_huber() -> None:
    """Squared errors instead of the Huber norm; the cutoff of the tracking stays."""
    _set_everywhere("HUBER", np.float32(1e6))
    tracking_kernels.HUBER = np.float32(TrackingConfig.cutoff)  # type: ignore[attr-defined]  # as imported there


def without_gradient_weight() -> None:
    """The same weight for all pixels of the pattern."""
    _set_everywhere("GRADIENT_WEIGHT", np.float32(1e12))


def without_first_estimates() -> None:
    """Jacobians of the bundle adjustment at the newest estimate, though the prior was linearised at an earlier one."""

    def at_the_estimate(keyframes: KeyframeArrays, n: int, intrinsics: np.ndarray) -> PairGeometry:
        newest = keyframes._replace(T_camera_world_eval=keyframes.T_camera_world, affine_eval=keyframes.affine)
        return pair_geometry(newest, n, intrinsics)

    linearization.pair_geometry = at_the_estimate  # type: ignore[attr-defined]  # as imported there


def without_second_plane() -> None:
    """The initialiser keeps the first of the two motions by which a plane explains a pair of images."""
    initialization.Initializer._try_dual = lambda self, image_slot: None  # type: ignore[method-assign]  # the change


CHANGES: Dict[str, Callable[[], None]] = {
    "no Huber norm": without_huber,
    "no gradient weight": without_gradient_weight,
    "no first-estimate Jacobians": without_first_estimates,
    "initialiser: first solution of a plane": without_second_plane,
}


def _set_everywhere(name: str, value: np.float32) -> None:
    """Give a constant another value in all modules of the odometry, before anything is compiled."""
    for module in [module for path, module in sys.modules.items() if path.startswith(dso.__name__)]:
        if hasattr(module, name):
            setattr(module, name, value)
