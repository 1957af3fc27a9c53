# SPDX-License-Identifier: BSD-3-Clause
"""The scale that a second camera measures, as factors of the graph.

The second camera tells z_k, the logarithm of metres per unit at keyframe k, with an error of its own and one that all
keyframes have in common, that of the cameras' geometry. The graph's lengths are those of the wheels at their nominal
mean radius. The two metres differ by the errors of radius and geometry, which stay. So there is one more variable,
n = ln(metres by the wheels / metres by the cameras), with a prior, and with l_k as in `factors`

    e_k = l_k - n - z_k,    e_0 = n.

Averaging over keyframes makes the scale better only as far as the common error allows, because n takes that up.
"""

import math
from typing import List, Optional, Tuple

import gtsam
from gtsam.symbol_shorthand import N

from ceiling_dso_ros.dso.status import KeyframeEstimate, ScaleMeasurement

METRE_KEY = N(0)  # n
LARGEST, LEAST_SIGMA = 15.0, 1e-6  # of a logarithm, and of its standard deviation: what else is sent makes no sense


def usable_scale(keyframe: KeyframeEstimate) -> Optional[ScaleMeasurement]:
    """What the second camera says of a keyframe; None where it says nothing, or nothing that makes sense."""
    log_scale, sigma, common_sigma = keyframe.scale
    usable = abs(log_scale) < LARGEST and LEAST_SIGMA < sigma < LARGEST and 0.0 <= common_sigma < LARGEST
    return keyframe.scale if usable else None


def metre_sigma(stereo: ScaleMeasurement, radius_sigma: float) -> float:
    """Standard deviation of n before it is measured: of the cameras' geometry and of the mean wheel radius."""
    return max(math.hypot(stereo.common_sigma, radius_sigma), 1e-6)


def stereo_factor(scale_key: int, stereo: ScaleMeasurement, robust_threshold: float) -> gtsam.NonlinearFactor:
    """e_k, robust: a roof that repeats itself may be found at a wrong distance."""
    huber = gtsam.noiseModel.mEstimator.Huber.Create(robust_threshold)
    noise = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Isotropic.Sigma(1, stereo.sigma))
    return gtsam.BetweenFactorDouble(METRE_KEY, scale_key, stereo.log_scale, noise)


def first_metre(
    values: gtsam.Values, stereo: Optional[ScaleMeasurement], radius_sigma: float
) -> List[gtsam.NonlinearFactor]:
    """e_0 and n itself, for the first measurement of the second camera; nothing, if there is none or n is known."""
    if stereo is None or values.exists(METRE_KEY):
        return []
    values.insert(METRE_KEY, 0.0)
    sigma = gtsam.noiseModel.Isotropic.Sigma(1, metre_sigma(stereo, radius_sigma))
    return [gtsam.PriorFactorDouble(METRE_KEY, 0.0, sigma)]


def metre_of(values: gtsam.Values) -> float:
    """n; nan before the second camera has measured anything."""
    return float(values.atDouble(METRE_KEY)) if values.exists(METRE_KEY) else math.nan


def fields_of(stereo: Optional[ScaleMeasurement]) -> Tuple[bool, Tuple[float, float, float]]:
    """As MOTION has it: whether there is a measurement, and its numbers."""
    return stereo is not None, (0.0, 0.0, 0.0) if stereo is None else (*stereo,)
