# SPDX-License-Identifier: BSD-3-Clause
"""How the time of an image grows with points, window and image size: settings, table and figure.

The drive is the beginning of `loops` on `factory`; points are the active ones of the window, with three candidates for
four of them, as the defaults have it.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Sequence, Tuple

import matplotlib as mpl
from matplotlib.figure import Figure
from tabulate import tabulate

from ceiling_dso_ros.dso.config import WindowConfig
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrives
from ceiling_dso_ros.simulation.config import SimulationConfig

DURATION_S = 20.0
POINTS = (500, 1000, 2000, 4000)
WINDOWS = (5, 7, 15)
SIZES = ((424, 240), (848, 480), (1280, 720))
USUAL_SIZE = (848, 480)
# The published size of the window, of which the others are variations: not the package's own default.
USUAL = ("window.max_keyframes=7", "window.active_points=2000")
# Stages that form one group in the figure, in processing order.
GROUPS = {
    "image": ("undistort", "pyramid"),
    "track": ("track",),
    "trace": ("trace",),
    "activate": ("activate",),
    "optimise": ("optimize",),
    "marginalise": ("marginalize",),
    "select, reference": ("select", "reference"),
}
COLOURS = ("#BBBBBB", "#0072B2", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#E69F00")
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "ceiling_dso_ros"}


@dataclass(frozen=True)
class Variation:
    """One setting that differs from the usual ones.

    Attributes:
        quantity, value: the setting that is varied, and its value.
        settings: key=value texts for the odometry.
        size: width and height of the images, pixels.
    """

    quantity: str
    value: str
    settings: Tuple[str, ...] = ()
    size: Tuple[int, int] = USUAL_SIZE


@dataclass(frozen=True)
class Growth:
    """A variation and what `benchmark` measured.

    Attributes:
        result: what the command writes.
    """

    variation: Variation
    result: Mapping[str, Any]

    @property
    def stages_ms(self) -> Dict[str, float]:
        """Mean per image of each group of stages."""
        return stage_means_ms(self.result)


def variations() -> Iterator[Variation]:
    """All variations; each quantity includes the default value."""
    for points in POINTS:
        settings = f"window.active_points={points}", f"window.candidate_points={3 * points // 4}"
        yield Variation("points", str(points), settings)
    for keyframes in WINDOWS:
        settings = f"window.max_keyframes={keyframes}", f"window.min_keyframes={min(keyframes, 5)}"
        yield Variation("keyframes in the window", str(keyframes), settings)
    for size in SIZES:
        yield Variation("image", "x".join(map(str, size)), size=size)
    own = WindowConfig()
    settings = f"window.max_keyframes={own.max_keyframes}", f"window.active_points={own.active_points}"
    yield Variation("default", f"{own.max_keyframes} keyframes,\n{own.active_points} points", settings)


def measure_growth(drives: RenderedDrives, benchmark: Callable[..., Dict[str, Any]]) -> List[Growth]:
    """Measure all variations.

    Args:
        benchmark: called with a bag and `--set` texts, returns what the command `benchmark` writes.
    """
    usual = SimulationConfig("loops", "factory", duration_s=DURATION_S)
    found = []
    for variation in variations():
        width, height = variation.size
        drive = drives.drive(replace(usual, camera=replace(usual.camera, width=width, height=height)))
        found.append(Growth(variation, benchmark(drive.bag, *USUAL, *variation.settings)))
    return found


def stage_means_ms(result: Mapping[str, Any]) -> Dict[str, float]:
    """Mean per image of the groups of stages, from their means of keyframes and of other images."""
    mean, keyframe, other = (result["frame_ms"][kind] for kind in ("all", "keyframes", "others"))
    share = (mean - other) / (keyframe - other)
    of_keyframes, of_others = result["stage_ms"]["keyframes"], result["stage_ms"]["others"]
    return {
        group: sum(share * of_keyframes.get(s, 0.0) + (1.0 - share) * of_others.get(s, 0.0) for s in stages)
        for group, stages in GROUPS.items()
    }


def describe(found: Sequence[Growth]) -> str:
    """A table in Markdown, milliseconds."""
    rows = []
    for growth in found:
        frame_ms = growth.result["frame_ms"]
        rows.append(
            {
                "": f"{growth.variation.quantity} {growth.variation.value}".replace("\n", " "),
                "mean": frame_ms["all"],
                "keyframe": frame_ms["keyframes"],
                "other": frame_ms["others"],
                "MB": growth.result["peak_memory_mb"],
                **growth.stages_ms,
            }
        )
    return tabulate(rows, headers="keys", tablefmt="github", floatfmt=".2f")


def write_figure(path: Path, found: Sequence[Growth]) -> None:
    """Stacked bars of the stages' means, one panel for each quantity, as SVG."""
    quantities = list(dict.fromkeys(growth.variation.quantity for growth in found))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.2), layout="constrained")
        widths = [sum(growth.variation.quantity == quantity for growth in found) for quantity in quantities]
        panels = figure.subplots(1, len(quantities), sharey=True, width_ratios=widths)
        for axes, quantity in zip(panels, quantities):
            members = [growth for growth in found if growth.variation.quantity == quantity]
            labels, bottom = [growth.variation.value for growth in members], [0.0] * len(members)
            for group, colour in zip(GROUPS, COLOURS):
                heights = [growth.stages_ms[group] for growth in members]
                axes.bar(labels, heights, 0.7, bottom, color=colour, label=group)
                bottom = [low + height for low, height in zip(bottom, heights)]
            axes.set_xlabel(quantity)
        panels[0].set_ylabel("mean of an image [ms]")
        panels[0].legend(fontsize=7, frameon=False)
        figure.savefig(path, metadata={"Date": None, "Creator": None})
