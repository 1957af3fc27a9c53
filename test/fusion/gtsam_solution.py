# SPDX-License-Identifier: BSD-3-Clause
"""The graph of a whole drive in gtsam, against which what is our own is tested."""

import gtsam
from winding_chain import NOISE

from ceiling_dso_ros.fusion import factors
from ceiling_dso_ros.fusion.graph import FactorBuilder
from ceiling_dso_ros.fusion.linear import LINEAR_SOLVER
from ceiling_dso_ros.fusion.metre import first_metre


def whole_graph(intervals, settings):
    """The graph, and where the wheels and the camera's turns lead to."""
    builder = FactorBuilder(settings, NOISE)
    graph, values = gtsam.NonlinearFactorGraph(), builder.first_values()
    for factor in builder.first_factors():
        graph.push_back(factor)
    pose = gtsam.Pose2()
    for interval in intervals:
        pose = pose.compose(builder.guess(interval))
        values.insert(factors.pose_key(interval.end), pose)
        values.insert(factors.scale_key(interval.end), builder.first_log_scale(interval)[0])
        of_metre = first_metre(values, interval.stereo, NOISE.config.radius_sigma)
        for factor in [*builder.factors(interval), *of_metre]:
            graph.push_back(factor)
    return graph, values


def solved(graph, values):
    """By Levenberg-Marquardt, to the last digits."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType(LINEAR_SOLVER)
    parameters.setMaxIterations(1000)
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
