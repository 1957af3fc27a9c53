# SPDX-License-Identifier: BSD-3-Clause
"""Changes of speed between images that no robot is capable of: an image was tracked wrongly, or the robot was hit."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.fusion.config import OutputConfig
from ceiling_dso_ros.fusion.twist_filter import GATE_SIGMAS, MeanTwist


class Leaps:
    """Judges the speed that the camera sees between two images by the one before.

    One image alone that is torn or shows something else seems to leap, and the next one leaps back. A robot that
    drives against a wall stays there: the next image confirms it.

    Args:
        config: has the robot's largest accelerations.
    """

    def __init__(self, config: OutputConfig) -> None:
        self.configure(config)
        self._last: Optional[MeanTwist] = None
        self._leap: Optional[MeanTwist] = None

    def configure(self, config: OutputConfig) -> None:
        """Let other accelerations count from now on."""
        self._largest = np.array([config.acceleration_m_s2, config.acceleration_rad_s2])

    def leaves_out(self, seen: MeanTwist, contradicted: bool) -> bool:
        """Whether an image has leapt; if not, the next one is judged by it.

        Args:
            seen: its motion since the last image that was used.
            contradicted: by the wheels; what they agree with is no leap.
        """
        if contradicted and self._last is not None and not self._possible(self._last, seen):
            self._leap = seen
            return True
        self._last = seen
        return False

    def confirms(self, further: Optional[MeanTwist]) -> bool:
        """Whether the motion from the image that leapt to the next one goes on as the leap."""
        leap, self._leap = self._leap, None
        if leap is None or further is None or not self._possible(leap, further):
            return False
        self._last = further
        return True

    def _possible(self, before: MeanTwist, after: MeanTwist) -> bool:
        between_s = 0.5 * seconds(after.end_ns + after.start_ns - before.end_ns - before.start_ns)
        sigmas = np.sqrt(np.diag(before.covariance) + np.diag(after.covariance))
        return bool((np.abs(after.rate - before.rate) <= self._largest * between_s + GATE_SIGMAS * sigmas).all())
