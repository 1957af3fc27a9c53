# SPDX-License-Identifier: BSD-3-Clause
"""Figures of an evaluation: the trajectories from above and the error over the distance, as PNG and SVG.

The same numbers give the same bytes: no dates, fixed identifiers.
"""

import functools
import io
from pathlib import Path
from typing import Callable, Dict, Optional, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ceiling_dso_ros.evaluation.report import TrajectoryEvaluation
from ceiling_dso_ros.io.replacing import replace_file

# Okabe and Ito's palette: told apart by colour-blind readers, too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
REFERENCE_COLOUR = "#888888"
STYLE = {
    "font.size": 9,
    "axes.edgecolor": "#555555",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "grid.color": "#E5E5E5",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "svg.hashsalt": "ceiling_dso_ros",
}
# Matplotlib's own fields that change with time or version.
METADATA: Dict[str, Dict[str, Optional[str]]] = {".png": {"Software": None}, ".svg": {"Date": None, "Creator": None}}


FIGURES = ("trajectory", "error")
FILES = tuple(f"{figure}{ending}" for figure in FIGURES for ending in METADATA)


def figure_writers(
    references_m: Sequence[np.ndarray], evaluations: Sequence[TrajectoryEvaluation]
) -> Dict[str, Callable[[Path], None]]:
    """Each name of FILES -> what writes it to a path, whole or not at all; OutputError where it cannot.

    Args:
        references_m: (M, 3) float64 positions of each reference, all in one world, metres.
        evaluations: at least one, each against one of them.
    """
    draw: Dict[str, Callable[[], Figure]] = {
        "trajectory": functools.lru_cache(maxsize=None)(lambda: _trajectory_figure(references_m, evaluations)),
        "error": functools.lru_cache(maxsize=None)(lambda: _error_figure(evaluations)),
    }
    return {name: functools.partial(save_figure, draw[name.split(".")[0]]) for name in FILES}


def _trajectory_figure(references_m: Sequence[np.ndarray], evaluations: Sequence[TrajectoryEvaluation]) -> Figure:
    """The trajectories seen along the reference world's z axis, as on a floor plan."""
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes = figure.add_subplot(title="Trajectory from above, aligned to the reference", xlabel="x [m]", ylabel="y [m]")
    for index, (x, y, _) in enumerate(positions_m.T for positions_m in references_m):
        label = None if index else "reference"
        axes.plot(x, y, color=REFERENCE_COLOUR, linewidth=2.6, label=label)
    for colour, evaluation in zip(_colours(evaluations), evaluations):
        x, y = evaluation.aligned[:, 0, 3], evaluation.aligned[:, 1, 3]
        axes.plot(x, y, color=colour, linewidth=1.1, label=evaluation.name)
        axes.plot(x[0], y[0], marker="o", markersize=5, color=colour, markeredgecolor="white")
    axes.plot([], [], "o", color="#555555", markersize=5, label="first pose")
    axes.set_aspect("equal", adjustable="datalim")
    _legend(axes)
    return figure


def _error_figure(evaluations: Sequence[TrajectoryEvaluation]) -> Figure:
    """The paper's figures 8 and 9: epsilon_i over the distance travelled."""
    largest_m = max(evaluation.position_errors_m.max() for evaluation in evaluations)
    unit, factor = ("mm", 1e3) if largest_m < 0.1 else ("m", 1.0)
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.add_subplot(
        title="Position error after alignment",
        xlabel="distance travelled [m]",
        ylabel=f"position error [{unit}]",
    )
    for colour, evaluation in zip(_colours(evaluations), evaluations):
        label = f"{evaluation.name}: RMSE {evaluation.ate_m.rmse * factor:.3g} {unit}"
        axes.plot(
            evaluation.travelled_m, evaluation.position_errors_m * factor, color=colour, linewidth=0.8, label=label
        )
    axes.margins(x=0.01)
    axes.set_ylim(bottom=0.0)
    _legend(axes)
    return figure


def _colours(evaluations: Sequence[TrajectoryEvaluation]) -> Sequence[str]:
    return [COLOURS[index % len(COLOURS)] for index in range(len(evaluations))]


def _legend(axes: Axes) -> None:
    """Draw the legend below the axes, where it hides nothing."""
    axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def save_figure(draw: Callable[[], Figure], path: Path) -> None:
    """Write a figure as PNG or SVG, as the ending says.

    Raises:
        OutputError: the file cannot be written.
    """
    content = io.BytesIO()
    with mpl.rc_context(STYLE):
        draw().savefig(content, format=path.suffix[1:], dpi=150, metadata=METADATA[path.suffix])
    replace_file(path, content.getvalue(), "the figure")
