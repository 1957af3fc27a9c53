# SPDX-License-Identifier: BSD-3-Clause
"""The part of an image that the odometry can track."""

from typing import Tuple

from ceiling_dso_ros.dso.images.pyramid import MAX_LEVELS, MIN_LEVELS, PyramidShape


def trackable_size(width: int, height: int) -> Tuple[int, int]:
    """The largest (width, height) within an image of this size that can be halved often enough.

    That is the image itself if the odometry can track it. Otherwise it loses less than four percent of a side: it is
    cropped so that it has as many pyramid levels as there are for its number of pixels, because large motions are found
    on the coarsest level. An image that is too small keeps its size.
    """
    if PyramidShape.of(width, height).levels >= MIN_LEVELS:
        return width, height
    for levels in range(MAX_LEVELS, MIN_LEVELS - 1, -1):
        block = 2 ** (levels - 1)
        size = width // block * block, height // block * block
        if PyramidShape.of(*size).levels >= levels:
            return size
    return width, height
