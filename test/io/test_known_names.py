# SPDX-License-Identifier: BSD-3-Clause
import re

import pytest

from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.known_names import all_names, require_known

KNOWN = {"publish_tf": False, "window": {"max_keyframes": 10, "active_points": 1000}, "robot": {"mount": {"xyz": []}}}


def test_known_names_pass_at_every_depth():
    require_known({}, KNOWN, "node")
    require_known({"publish_tf": 1, "window": {"active_points": 5}, "robot": {"mount": {"xyz": 0}}}, KNOWN, "node")


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"publish_ft": True}, "publish_ft is unknown; did you mean publish_tf?"),
        ({"windows": {"max_keyframes": 5}}, "windows.max_keyframes is unknown; did you mean window.max_keyframes?"),
        ({"windows": 5}, "windows is unknown; did you mean window?"),
        ({"robot": {"mount": {"xy": 0}}}, "robot.mount.xy is unknown; did you mean robot.mount.xyz?"),
        ({"q": 1}, "q is unknown; there are publish_tf, window, robot"),
        ({"window": [1]}, "window is a group of values, not one: max_keyframes, active_points"),
        ({"publish_tf": {"x": 1}}, "publish_tf.x is unknown; did you mean publish_tf?"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest_one(values, complaint):
    with pytest.raises(InputError, match=re.escape(f"node: {complaint}")):
        require_known(values, KNOWN, "node")


def test_all_names():
    assert list(all_names(KNOWN)) == [
        "publish_tf", "window", "window.max_keyframes", "window.active_points", "robot", "robot.mount",
        "robot.mount.xyz",
    ]  # fmt: skip
