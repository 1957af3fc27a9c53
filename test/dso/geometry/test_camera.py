# SPDX-License-Identifier: BSD-3-Clause
"""What a camera accepts."""

import numpy as np
import pytest

from ceiling_dso_ros.dso.geometry.camera import PinholeCamera


def test_matrix_and_parameters_agree():
    camera = PinholeCamera(200.0, 210.0, 151.0, 117.0, 320, 240)
    assert camera.matrix @ [0.1, -0.2, 1.0] == pytest.approx([171.0, 75.0, 1.0])
    assert camera.parameters.tolist() == [200.0, 210.0, 151.0, 117.0]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((np.nan, 200, 160, 120, 320, 240), "finite"),
        ((200, np.inf, 160, 120, 320, 240), "finite"),
        ((0, 200, 160, 120, 320, 240), "positive"),
        ((200, -200, 160, 120, 320, 240), "positive"),
        ((200, 200, 160, 120, 63, 240), "63x240"),
        ((200, 200, 160, 120, 320, 12), "320x12"),
    ],
)
def test_impossible_cameras_are_refused(values, said):
    with pytest.raises(ValueError, match=said):
        PinholeCamera(*values)
