# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.slam.deciding import WIDE_GATE, Gate, Sighting, agreeing, distance

NONE = np.zeros((0, 3))
COVARIANCE = np.diag([1e-4, 1e-4, 1e-6])


def seen(motion, others=NONE):
    return Sighting(10, 3, np.array(motion), COVARIANCE, np.array(others))


def test_the_gate_is_as_wide_as_the_odometry_is_unsure():
    close, wide = (Gate(np.zeros(3), np.diag([sigma**2, sigma**2, 1e-4])) for sigma in (0.02, 0.5))
    assert "outside" in close.why_not(seen([1.2, 0.0, 0.0]))
    assert wide.why_not(seen([1.2, 0.0, 0.0])) == ""
    assert close.why_not(seen([0.03, 0.0, 0.0])) == ""


def test_a_second_explanation_within_the_gate_holds_a_loop_back():
    gate = Gate(np.zeros(3), np.diag([0.25, 0.25, 1e-4]))
    assert "ambiguous" in gate.why_not(seen([0.1, 0.0, 0.0], [[1.3, 0.0, 0.0]]))
    assert gate.why_not(seen([0.1, 0.0, 0.0], [[4.0, 0.0, 0.0]])) == ""


def test_estimates_that_agree_are_one_group():
    shifted = [(i, np.array([1.2, 0.0, 0.0]), COVARIANCE) for i in (1, 2)]
    right = [(i, np.array([0.01 * i, 0.0, 0.0]), COVARIANCE) for i in (3, 4, 5)]
    groups = agreeing([*shifted, *right])
    assert groups == [[2, 3, 4], [0, 1]]


def test_a_gate_admits_what_is_within_it_at_any_yaw():
    rng = np.random.default_rng(3)
    gate = Gate(np.array([1.0, -2.0, 3.1]), np.diag([0.04, 0.01, 0.0004]))
    covariance = np.diag([1e-4, 1e-4, 1e-6])
    motions = np.array([planar.compose(gate.predicted, rng.normal(0.0, [1.0, 0.5, 0.1])) for _ in range(300)])
    expected = [distance(gate.predicted, gate.covariance + covariance, motion) < WIDE_GATE for motion in motions]
    assert 20 < sum(expected) < 280
    assert gate.admits(motions, covariance).tolist() == expected
    assert gate.admits(np.zeros((0, 3)), covariance).tolist() == []
