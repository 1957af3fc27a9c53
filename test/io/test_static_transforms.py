# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from ceiling_dso_ros.io.ros_messages import message, transform_stamped
from ceiling_dso_ros.io.static_transforms import StaticTransforms


def translation(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def quarter_turn():
    T = np.eye(4)
    T[:2, :2] = [[0, -1], [1, 0]]
    return T


def tree(*transforms):
    return StaticTransforms(
        message("tf2_msgs/TFMessage", transforms=[transform_stamped(0, *transform)]) for transform in transforms
    )


def test_along_a_chain_of_messages():
    transforms = tree(("mast", "camera", quarter_turn()), ("base_link", "mast", translation(0, 0, 1)))
    expected = translation(0, 0, 1) @ quarter_turn()
    np.testing.assert_allclose(transforms.lookup("base_link", "camera"), expected, atol=1e-15)
    np.testing.assert_allclose(transforms.lookup("camera", "base_link"), np.linalg.inv(expected), atol=1e-15)


def test_between_branches():
    transforms = tree(("root", "base_link", quarter_turn()), ("root", "camera", translation(1, 0, 0)))
    expected = np.linalg.inv(quarter_turn()) @ translation(1, 0, 0)
    np.testing.assert_allclose(transforms.lookup("base_link", "camera"), expected, atol=1e-15)


def test_frames_with_a_leading_slash_and_the_same_frame():
    transforms = tree(("/base_link", "/camera", quarter_turn()))
    assert transforms.lookup("base_link", "camera") is not None
    np.testing.assert_array_equal(transforms.lookup("camera", "camera"), np.eye(4))


def test_the_last_word_about_a_frame_counts():
    transforms = tree(("base_link", "camera", quarter_turn()), ("base_link", "camera", translation(1, 2, 3)))
    np.testing.assert_array_equal(transforms.lookup("base_link", "camera"), translation(1, 2, 3))


def test_frames_that_are_not_connected():
    assert tree(("mast", "camera", quarter_turn())).lookup("base_link", "camera") is None
    assert tree().lookup("base_link", "camera") is None


def test_a_loop_ends():
    assert tree(("a", "b", np.eye(4)), ("b", "a", np.eye(4))).lookup("base_link", "a") is None


@pytest.mark.parametrize(
    "quaternion", [(0, 0, 0, 0), (np.nan, 0, 0, 1), (0, 0, 0, 1.1), (1e-4, 0, 0, 0), (1e200, 0, 0, 1)]
)
def test_what_tf2_ignores_is_ignored(quaternion):
    good = ("base_link", "camera", translation(0, 0, 1))
    bad = transform_stamped(0, "base_link", "camera", np.eye(4))
    for name, value in zip("xyzw", quaternion):
        setattr(bad.transform.rotation, name, float(value))
    transforms = tree(good)
    transforms.add(message("tf2_msgs/TFMessage", transforms=[bad]))
    np.testing.assert_array_equal(transforms.lookup("base_link", "camera"), translation(0, 0, 1))
    assert transforms.frames == ["base_link", "camera"]


def test_a_translation_that_is_not_finite_and_a_frame_without_a_name_are_ignored():
    transforms = tree(("base_link", "camera", translation(0, np.nan, 1)), ("", "camera", np.eye(4)))
    assert transforms.frames == []
