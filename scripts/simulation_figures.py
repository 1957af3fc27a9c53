#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Draws the simulator's figures of the README: .venv/bin/python scripts/simulation_figures.py [docs/images].

ceilings.png shows the camera's view under every ceiling, random_halls.png under some that are drawn at random;
wheel_drift.png shows the dead reckoning on `square` and `loops`.
"""

import sys
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.io.recording import RobotDescription
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.ceilings import CEILINGS
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.drawn import RANDOM_CEILING, draw_config
from ceiling_dso_ros.simulation.simulation import Simulation

VIEWS = (0.2, 0.38, 0.8)  # shares of the sequence
VIEW_SIZE = (328, 186)
DRAWN_SEEDS, DRAWN_COLUMNS, DRAWN_VIEW = range(12, 28), 4, 0.38
LABEL_PX, GAP_PX = 22, 6
PNG_METADATA = {"Software": None}  # the same figures, the same bytes
TRUTH, NOMINAL, TRUE = "#888888", "#D55E00", "#0072B2"


def contact_sheet() -> np.ndarray:
    """Three views under every ceiling, a row each: (H, W) uint8."""
    clean = CameraModel(read_noise=0.0, shot_noise=0.0)
    rows = []
    for ceiling in (name for name in CEILINGS if name != RANDOM_CEILING):
        simulation = Simulation(SimulationConfig("loops", ceiling, camera=clean))
        count = len(simulation.frame_times_s)
        views = [simulation.frame(int(share * count)).image for share in VIEWS]
        views = [cv2.resize(view, VIEW_SIZE, interpolation=cv2.INTER_AREA) for view in views]
        gap = np.full((VIEW_SIZE[1], GAP_PX), 255, dtype=np.uint8)
        row = np.hstack([views[0], gap, views[1], gap, views[2]])
        label = np.full((LABEL_PX, row.shape[1]), 255, dtype=np.uint8)
        cv2.putText(label, ceiling, (2, LABEL_PX - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0,), 1, cv2.LINE_AA)
        rows += [label, row]
    return np.vstack(rows)


def random_halls() -> np.ndarray:
    """A view under each of some halls that are drawn at random, with their cameras: (H, W) uint8."""
    views = []
    for seed in DRAWN_SEEDS:
        simulation = Simulation(draw_config("loops", seed))
        image = simulation.frame(int(DRAWN_VIEW * len(simulation.frame_times_s))).image
        views.append(cv2.resize(image, VIEW_SIZE, interpolation=cv2.INTER_AREA))
    return np.vstack([np.hstack(views[k : k + DRAWN_COLUMNS]) for k in range(0, len(views), DRAWN_COLUMNS)])


def dead_reckoning(simulation: Simulation, robot: RobotDescription) -> np.ndarray:
    """Positions (N, 2) in the hall, integrated from the ticks with the dimensions of a robot."""
    model = RobotModel(robot.T_base_camera, robot.wheel_base_m, robot.wheel_radius_m, robot.ticks_per_turn)
    odometry = WheelOdometry(model, WheelConfig())
    positions = []
    for time_s, (left, right) in zip(simulation.encoders.time_s, simulation.encoders.counters):
        odometry.add_ticks(time_s, int(left), int(right))
        positions.append(odometry.total.pose[:2])
    x, y, yaw = simulation.robot.motion.poses(simulation.encoders.time_s[:1])[0]
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array(positions) @ np.array([[c, s], [-s, c]]) + [x, y]


def draw_drift(axes: Axes, sequence: str) -> None:
    """One sequence from above."""
    simulation = Simulation(SimulationConfig(sequence))
    truth = simulation.robot.motion.poses(simulation.encoders.time_s)[:, :2]
    nominal, true = (dead_reckoning(simulation, robot) for robot in (simulation.nominal, simulation.robot.true))
    axes.plot(*truth.T, color=TRUTH, linewidth=3.0, label="truth")
    axes.plot(*nominal.T, color=NOMINAL, label="wheels, nominal dimensions")
    axes.plot(*true.T, color=TRUE, linewidth=0.8, label="wheels, true dimensions")
    ends = [np.linalg.norm(path[-1] - truth[-1]) for path in (nominal, true)]
    axes.set_title(
        f"{sequence}: {ends[0]:.2f} m off at the end, {1000 * ends[1]:.0f} mm with the true ones", fontsize=9
    )
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.grid(color="#E5E5E5", linewidth=0.6)


def drift_figure() -> Figure:
    """Dead reckoning of both of the paper's sequences."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_drift(left, "square")
    draw_drift(right, "loops")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def main() -> None:
    """Write the figures."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images")
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / "ceilings.png"), contact_sheet(), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    cv2.imwrite(str(folder / "random_halls.png"), random_halls(), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        drift_figure().savefig(folder / "wheel_drift.png", dpi=110, metadata=PNG_METADATA)


if __name__ == "__main__":
    main()
