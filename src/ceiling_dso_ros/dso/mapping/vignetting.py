# SPDX-License-Identifier: BSD-3-Clause
"""Finds the vignetting of the camera while it drives, and corrects the images of the window."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.images.pattern import PATTERN_X, PATTERN_Y
from ceiling_dso_ros.dso.images.vignette import TERMS, Vignette, largest_radius2, log_share
from ceiling_dso_ros.dso.mapping.vignetting_kernels import COLUMNS, add_pixels
from ceiling_dso_ros.dso.window.keyframe_window import KeyframeWindow
from ceiling_dso_ros.dso.window.pair_geometry import pair_geometry
from ceiling_dso_ros.dso.window.points import INLIER

AFFINE = slice(0, 2)  # columns of the normal equations of a pair
COEFFICIENTS = slice(2, 2 + TERMS)
RESIDUAL = 2 + TERMS
PRIOR_SIGMA = 0.5  # of a coefficient: few lenses lose more than half of the light in their corners
LEAST_PIXELS = 400  # of a pair: 50 points; fewer hardly tell its gain and offset from the vignetting
LEAST_INFORMATION = 1e4  # of a block: a coefficient with a sigma of 0.05 where pixels err by 5 grey levels
SETTLED = 10  # blocks without a change; from then on one keyframe of a block is enough
CHANCE = 1e-4  # that a block changes the vignette without a reason
NOTICEABLE = 0.5 / 128  # ln V: half a grey level of a pixel that is neither dark nor bright


class VignetteEstimator:
    """Estimates the vignette from the points that keyframes share, over all segments.

    The keyframes of a block see mostly the same points, and what disturbs the estimate, reflections and light that
    moves, is alike in them: a block counts as one measurement, and the scatter of the blocks tells how exact they are.
    While images are corrected too little, points that do not fit are left out, and the others tell too small a change.
    So after each change it measures anew, until no change is significant.

    Attributes:
        vignette: by which the images of the newest keyframe, and of all after it, are divided.
    """

    def __init__(self, camera: PinholeCamera, block: int) -> None:
        """Begin without vignetting; `block` is how many keyframes see mostly the same points."""
        self.vignette = Vignette(camera)
        self._camera = camera
        self._centre = np.array([camera.cx, camera.cy])
        self._radius2 = largest_radius2(camera)
        self._block = block
        self._H, self._g, self._keyframes = np.zeros((TERMS, TERMS)), np.zeros(TERMS), 0  # of the current block
        self._forget()

    def update(self, window: KeyframeWindow) -> None:
        """Learn from the newest keyframe; corrects the window's images and grey values if the vignette changes."""
        if window.count < self._block:
            return  # the map is still too rough
        if self._blocks < SETTLED or self._keyframes == 0:
            self._add_keyframe(window)
        self._keyframes += 1
        if self._keyframes < self._block:
            return
        self.close_block()
        change = self.significant_change()
        if change is not None:
            c1, c2 = change + self.vignette.coefficients
            self.vignette = Vignette(self._camera, (float(c1), float(c2)))
            self._correct(window, change)
            self._forget()

    def add_pair(self, total: np.ndarray) -> None:
        """Add the normal equations of a pair of keyframes to the block.

        Args:
            total: (5, 5) float64, as `vignetting_kernels.add_pixels` fills it.
        """
        affine = np.linalg.pinv(total[AFFINE, AFFINE], rcond=1e-9, hermitian=True)
        eliminated = total[COEFFICIENTS, AFFINE] @ affine
        self._H += total[COEFFICIENTS, COEFFICIENTS] - eliminated @ total[AFFINE, COEFFICIENTS]
        self._g += total[COEFFICIENTS, RESIDUAL] - eliminated @ total[AFFINE, RESIDUAL]

    def close_block(self) -> None:
        """Count the block as one measurement, unless it tells too little."""
        H, g = self._H, self._g
        if np.linalg.eigvalsh(H)[0] > LEAST_INFORMATION:
            self._blocks += 1
            self._sum_H += H
            self._sum_g += g
            self._sum_gHg += float(g @ np.linalg.solve(H, g))
        self._H, self._g, self._keyframes = np.zeros((TERMS, TERMS)), np.zeros(TERMS), 0

    def significant_change(self) -> Optional[np.ndarray]:
        """Change of the coefficients, (2,) float64, in which the blocks agree; None if there is none that matters.

        An F test with the scatter of the blocks. Directions of which they tell little are held by a prior.
        """
        freedom = TERMS * (self._blocks - 1)
        if freedom < 1:
            return None
        change = np.linalg.solve(self._sum_H, self._sum_g)
        explained = change @ self._sum_g
        variance = (self._sum_gHg - explained) / freedom
        quantile = 0.5 * freedom * (CHANCE ** (-2.0 / freedom) - 1.0)  # of F(2, freedom), which has this closed form
        if explained / TERMS <= quantile * variance:
            return None
        prior = variance / PRIOR_SIGMA**2
        held = self._sum_g - prior * np.array(self.vignette.coefficients)
        change = np.linalg.solve(self._sum_H + prior * np.eye(TERMS), held)
        return change if largest_log(change) > NOTICEABLE else None

    def _forget(self) -> None:
        self._blocks = 0
        self._sum_H, self._sum_g, self._sum_gHg = np.zeros((TERMS, TERMS)), np.zeros(TERMS), 0.0

    def _add_keyframe(self, window: KeyframeWindow) -> None:
        newest, points, residuals = window.newest, window.points, window.points.residuals
        ranges = points.host_ranges(window.count)
        pairs = pair_geometry(window.keyframes, window.count, window.intrinsics)
        chosen = (residuals.live[newest, : points.count] > 0) & (residuals.state[newest, : points.count] == INLIER)
        arrays = points.arrays
        for host in range(newest):
            part, total = slice(ranges[host], ranges[host + 1]), np.zeros((COLUMNS, COLUMNS))
            pixels = add_pixels(
                window.image(newest), window.width, window.height, self._centre, self._radius2,
                pairs.KRKi[host, newest], pairs.Kt[host, newest], pairs.gain[host, newest], pairs.offset[host, newest],
                chosen[part], arrays.u[part], arrays.v[part], arrays.idepth[part], arrays.grey[:, part],
                arrays.weight[:, part], total,
            )  # fmt: skip
            if pixels >= LEAST_PIXELS:
                self.add_pair(total)

    def _correct(self, window: KeyframeWindow, change: np.ndarray) -> None:
        for slot in window.keyframes.image_slot[: window.count]:
            window.pool.correct(int(slot), self.vignette)
        for table in (window.points, window.candidates):
            arrays, n = table.arrays, table.count
            x = arrays.u[:n] + PATTERN_X[:, None] - self._centre[0]
            y = arrays.v[:n] + PATTERN_Y[:, None] - self._centre[1]
            arrays.grey[:, :n] *= np.exp(-log_share(change, (x * x + y * y) / self._radius2))


def largest_log(coefficients: np.ndarray) -> float:
    """Largest |ln V| in the image."""
    return float(np.abs(log_share(coefficients, np.linspace(0.0, 1.0, 11))).max())
