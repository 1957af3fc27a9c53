# SPDX-License-Identifier: BSD-3-Clause
"""Image pyramids in a pool of preallocated memory."""

from dataclasses import dataclass
from typing import Collection, List, Optional, Tuple

import numpy as np

from ceiling_dso_ros.dso.compute.jit import kernel_noalias
from ceiling_dso_ros.dso.config import ConfigError
from ceiling_dso_ros.dso.geometry.camera import PinholeCamera
from ceiling_dso_ros.dso.images.noise import smooth_image
from ceiling_dso_ros.dso.images.vignette import Vignette

MIN_PIXELS = 5000
MAX_LEVELS = 6
MIN_LEVELS = 3  # the pixel selection uses this many
QUARTER = np.float32(0.25)


@dataclass(frozen=True)
class PyramidShape:
    """Sizes of the levels and where each lies in a flat buffer.

    Attributes:
        sizes: (width, height) of each level, finest first.
        offsets: first pixel of each level in the buffer, and one past the last.
    """

    sizes: Tuple[Tuple[int, int], ...]
    offsets: Tuple[int, ...]

    @classmethod
    def of(cls, width: int, height: int) -> "PyramidShape":
        """Halve while both sides are even and a level has more than 5000 pixels, up to 6 levels."""
        sizes = [(width, height)]
        while width % 2 == 0 and height % 2 == 0 and width * height > MIN_PIXELS and len(sizes) < MAX_LEVELS:
            width, height = width // 2, height // 2
            sizes.append((width, height))
        offsets = np.concatenate([[0], np.cumsum([w * h for w, h in sizes])])
        return cls(tuple(sizes), tuple(int(offset) for offset in offsets))

    @property
    def levels(self) -> int:
        """How many levels there are."""
        return len(self.sizes)


def check_trackable(camera: PinholeCamera) -> None:
    """Refuse images whose pyramid has too few levels.

    Raises:
        ConfigError: they are too small, or cannot be halved often enough.
    """
    if PyramidShape.of(camera.width, camera.height).levels < MIN_LEVELS:
        raise ConfigError(
            f"images of {camera.width}x{camera.height} pixels: too small to be tracked, or not divisible by 4; "
            "20000 pixels at least"
        )


@kernel_noalias
def halve(fine: np.ndarray, fine_width: int, width: int, height: int, coarse: np.ndarray) -> None:
    """Mean of 2x2 pixels; flat arrays."""
    for y in range(height):
        top = fine[2 * y * fine_width : (2 * y + 1) * fine_width]
        bottom = fine[(2 * y + 1) * fine_width : (2 * y + 2) * fine_width]
        row = coarse[y * width : (y + 1) * width]
        for x in range(width):
            row[x] = QUARTER * (top[2 * x] + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1])


class PyramidPool:
    """Memory for a fixed number of pyramids, handed out as slot numbers.

    `buffers` is (slots, pixels of all levels) float32: kernels take it whole and pick slot and level themselves.
    """

    def __init__(self, camera: PinholeCamera, slots: int) -> None:
        self.shape = PyramidShape.of(camera.width, camera.height)
        self.buffers = np.zeros((slots, self.shape.offsets[-1]), np.float32)
        self._scratch = np.zeros((2, camera.height, camera.width), np.float32)
        self._free: List[int] = list(range(slots))
        self._none = Vignette(camera)
        self._vignettes = [self._none] * slots  # by which each was divided

    def build(self, image: np.ndarray, smooth: bool = False, vignette: Optional[Vignette] = None) -> int:
        """Fill a free slot with the pyramid of an image; returns the slot.

        Args:
            image: (height, width) float32 or uint8.
            smooth: against its noise, see `noise`.
            vignette: by which it is divided.
        """
        slot = self._free.pop()
        width, height = self.shape.sizes[0]
        finest = self.level(slot, 0).reshape(height, width)
        if smooth:
            raw, rows = self._scratch
            raw[:] = image
            smooth_image(raw, rows, finest)
        else:
            finest[:] = image
        self._vignettes[slot] = self._none
        if vignette is None or vignette.inverse is None:
            self._halve(slot)
        else:
            self.correct(slot, vignette)
        return slot

    def vignette(self, slot: int) -> Vignette:
        """By which the image in a slot was divided."""
        return self._vignettes[slot]

    def correct(self, slot: int, vignette: Vignette) -> None:
        """Divide the image in a slot by another vignette instead of the one by which it was divided."""
        before = self._vignettes[slot]
        if before.coefficients == vignette.coefficients:
            return
        width, height = self.shape.sizes[0]
        finest = self.level(slot, 0).reshape(height, width)
        if before.inverse is not None:
            finest /= before.inverse
        if vignette.inverse is not None:
            finest *= vignette.inverse
        self._vignettes[slot] = vignette
        self._halve(slot)

    def _halve(self, slot: int) -> None:
        for level in range(1, self.shape.levels):
            fine_width = self.shape.sizes[level - 1][0]
            halve(self.level(slot, level - 1), fine_width, *self.shape.sizes[level], self.level(slot, level))

    def level(self, slot: int, level: int) -> np.ndarray:
        """One level as a flat float32 view."""
        return self.buffers[slot, self.shape.offsets[level] : self.shape.offsets[level + 1]]

    def release(self, slot: int) -> None:
        """Give a slot back."""
        self._free.append(slot)

    def release_all(self, kept: Collection[int] = ()) -> None:
        """Give every slot back but those that are kept."""
        self._free = [slot for slot in range(self.buffers.shape[0]) if slot not in kept]
