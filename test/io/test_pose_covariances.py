# SPDX-License-Identifier: BSD-3-Clause
from pathlib import Path

import numpy as np
import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.pose_covariances import PoseCovariances, covariances_path, read_covariances, write_covariances

GOOD = "1.5 1e-4 0 0 1e-4 0 1e-6\n"


def test_what_is_written_is_read(tmp_path):
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 3, 3)) * 1e-3
    stamps = 1_700_000_000_123_456_789 + np.arange(5) * 10**8
    path = tmp_path / "reference.covariance.txt"
    write_covariances(path, PoseCovariances(stamps, roots @ roots.transpose(0, 2, 1)))
    found = read_covariances(path)
    assert found.stamps_ns.tolist() == stamps.tolist()
    np.testing.assert_allclose(found.matrices, roots @ roots.transpose(0, 2, 1), rtol=1e-8, atol=1e-18)
    assert covariances_path(Path("a/reference.tum")) == Path("a/reference.covariance.txt")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no covariances in it"),
        ("1.5 1 2 3\n", "six finite numbers"),
        ("1.5 1 0 0 nan 0 1\n", "six finite numbers"),
        ("1.5 1 0 0 x 0 1\n", "line 1"),
        ("soon 1 0 0 1 0 1\n", "line 1"),
        ("1.5 -1 0 0 1 0 1\n", "not positive"),
        ("1.5 0 0 0 0 0 0\n", "not positive"),
        ("1.5 1 5 0 1 0 1\n", "not positive"),
        (GOOD + GOOD, "line 2"),
    ],
)
def test_other_files_are_refused_with_a_line(tmp_path, text, words):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as error:
        read_covariances(path)
    assert str(path) in str(error.value)
