# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.lidar.rendering import FREE, OCCUPIED, UNKNOWN, MapImage
from ceiling_dso_ros.lidar.rendering_kernels import cast_rays


def test_rays_end_in_one_cell_and_pass_those_before():
    hits, passes = np.zeros((5, 20), np.int32), np.zeros((5, 20), np.int32)
    ends = np.array([[1.55, 0.25], [1.55, 0.25], [0.85, 0.25]])
    cast_rays(ends, np.array([0, 3]), np.array([[0.05, 0.25]]), np.zeros(2), 0.1, hits, passes)
    assert hits.sum() == 3 and hits[2, 15] == 2 and hits[2, 8] == 1
    assert passes[2, :8].min() == 3 and passes[2, 9:15].min() == 2
    assert passes[2, 15:].max() == 0 and passes[[0, 1, 3, 4]].max() == 0


def test_rays_beyond_the_map_do_no_harm():
    hits, passes = np.zeros((3, 3), np.int32), np.zeros((3, 3), np.int32)
    cast_rays(np.array([[9.0, -9.0]]), np.array([0, 1]), np.array([[0.15, 0.15]]), np.zeros(2), 0.1, hits, passes)
    assert hits.sum() == 0 and passes.sum() > 0


def test_the_files_of_map_server():
    pixels = np.array([[OCCUPIED, FREE, UNKNOWN], [FREE, FREE, FREE]], np.uint8)
    image = MapImage(pixels, (-1.0, 2.5), 0.05)
    assert image.pgm() == b"P5\n3 2\n255\n" + pixels.tobytes()
    assert image.yaml("a.pgm") == (
        b"image: a.pgm\nresolution: 0.05\norigin: [-1.000000, 2.500000, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n"
        b"free_thresh: 0.196\n"
    )
    # map_server: free below free_thresh of (255 - pixel) / 255, occupied above occupied_thresh
    assert (255 - FREE) / 255 < 0.196 < (255 - UNKNOWN) / 255 + 1e-3 < 0.65 < (255 - OCCUPIED) / 255
    np.testing.assert_allclose(
        image.columns_rows(np.array([[-1.0, 2.5], [-0.9, 2.6]])), [[0.0, 2.0], [2.0, 0.0]], atol=1e-9
    )
