#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Draws the figure of docs/architecture.md: .venv/bin/python scripts/architecture_figure.py [docs/images]."""

import sys
from pathlib import Path
from typing import NamedTuple, Tuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

# Inches from the lower left corner.
WIDTH, HEIGHT = 9.42, 6.56
COLUMNS = (0.26, 2.09, 3.92, 5.75, 7.58)
BOX_WIDTH, BOX_HEIGHT = 1.58, 1.0
CALLER, EVERY_IMAGE, EVERY_KEYFRAME, WINDOW = 5.24, 3.40, 1.86, 0.40  # lower edges of the rows
WINDOW_HEIGHT, LINE_PITCH = 0.88, 0.152
PANEL_TOP = EVERY_IMAGE + BOX_HEIGHT + 0.36

INK, FAINT = "#333333", "#777777"
STEP, PANEL, STORE, DATA = "#FFFFFF", "#F1F4F7", "#E3EDF6", "#0072B2"
# Text as outlines, so that it looks the same everywhere; fixed identifiers, so that it is the same bytes.
STYLE = {"svg.fonttype": "path", "svg.hashsalt": "ceiling_dso_ros", "font.size": 8}


class Step(NamedTuple):
    """A box of the figure: a step, its file, and the data that it produces."""

    column: int
    row: float
    title: str
    what: str
    file: str
    data: str = ""


STEPS = (
    Step(0, CALLER, "Take an image", "from a recording\nor a topic", "io/recording.py\nros/mailbox.py", "raw image"),
    Step(1, CALLER, "Preprocess", "correct brightness,\nundistort", "io/preprocessing.py", "float32 image"),
    Step(4, CALLER, "Record or publish", "", "playback/\nros/odometry_publisher.py", "*.tum, topics"),
    Step(0, EVERY_IMAGE, "Start", "pose and depth, once\nthere is parallax", "start/map_start.py", "FirstMap"),
    Step(1, EVERY_IMAGE, "Build pyramid", "into a slot of\nthe image pool", "images/pyramid.py", "Frame"),
    Step(2, EVERY_IMAGE, "Track", "coarse to fine on the\nnewest keyframe", "tracking/frame_tracker.py",
         "TrackedFrame"),
    Step(3, EVERY_IMAGE, "Trace", "narrow the depth of the\nwindow's candidates", "mapping/tracing_kernels.py"),
    Step(4, EVERY_IMAGE, "Keyframe?", "has it moved or\nchanged enough?", "mapping/keyframe_policy.py"),
    Step(4, EVERY_KEYFRAME, "Activate", "candidates become\npoints", "mapping/activation.py"),
    Step(3, EVERY_KEYFRAME, "Optimise", "Gauss-Newton over\nthe window", "adjustment/", "Linearization"),
    Step(2, EVERY_KEYFRAME, "Make reference", "all points in the\nnewest keyframe", "tracking/\ntracking_reference.py",
         "TrackingReference"),
    Step(1, EVERY_KEYFRAME, "Renew", "marginalise the old,\nselect new pixels", "adjustment/\nimages/selection.py",
         "Prior"),
)  # fmt: skip
STORES = (
    ("Prior", "what marginalised\nparts knew"),
    ("keyframes", "poses, brightness,\nintrinsics"),
    ("PointTable", "inverse depths,\nresiduals"),
    ("CandidateTable", "intervals of\ninverse depth"),
)


def middle(column: int) -> float:
    """Centre of a column."""
    return COLUMNS[column] + BOX_WIDTH / 2


def draw_box(axes: Axes, corner: Tuple[float, float], size: Tuple[float, float], colour: str, edge: str) -> None:
    """A rounded rectangle."""
    style = "round,pad=0,rounding_size=0.07"
    axes.add_patch(FancyBboxPatch(corner, *size, boxstyle=style, facecolor=colour, edgecolor=edge, linewidth=0.9))


def draw_step(axes: Axes, step: Step) -> None:
    """One step, its lines in the middle of the box."""
    draw_box(axes, (COLUMNS[step.column], step.row), (BOX_WIDTH, BOX_HEIGHT), STEP, INK)
    lines = [(step.title, {"weight": "bold", "size": 9})]
    lines += [(line, {}) for line in step.what.splitlines()]
    lines += [(line, {"family": "monospace", "size": 7, "color": FAINT}) for line in step.file.splitlines()]
    if step.data:
        lines.append((f"\N{RIGHTWARDS ARROW} {step.data}", {"color": DATA}))
    top = step.row + BOX_HEIGHT / 2 + LINE_PITCH * (len(lines) - 1) / 2
    for index, (text, style) in enumerate(lines):
        style = {"color": INK, **style}
        axes.text(middle(step.column), top - index * LINE_PITCH, text, ha="center", va="center", **style)


def draw_arrow(
    axes: Axes, start: Tuple[float, float], end: Tuple[float, float], label: str = "", style: str = "-|>"
) -> None:
    """A straight arrow, its label to the left of the middle."""
    line = {"arrowstyle": style, "color": INK, "linewidth": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
    axes.annotate("", xy=end, xytext=start, arrowprops=line)
    axes.text((start[0] + end[0]) / 2 - 0.07, (start[1] + end[1]) / 2, label, ha="right", va="center", color=DATA)


def draw_heading(axes: Axes, x: float, y: float, name: str, where_x: float, where: str) -> None:
    """Heading of a group: the class or method at x; at where_x, clear of the arrows, its file and when it runs."""
    axes.text(x, y, name, weight="bold", size=9, color=INK, va="center")
    axes.text(where_x, y, where, color=FAINT, va="center")


def draw_groups(axes: Axes) -> None:
    """Draw the groups to which the steps belong."""
    left, bottom = COLUMNS[0] - 0.16, WINDOW - 0.18
    draw_box(axes, (left, bottom), (WIDTH - 2 * left, PANEL_TOP - bottom), PANEL, "none")
    x, clear = COLUMNS[0] + 0.02, 0.12
    draw_heading(
        axes, x, HEIGHT - 0.16, "Playback or DsoServer", COLUMNS[1] + 0.02, "playback/playback.py, ros/dso_server.py"
    )
    draw_heading(axes, x, PANEL_TOP - 0.18, "DirectOdometry.track", middle(1) + clear, "every image: dso/odometry.py")
    y = EVERY_KEYFRAME + BOX_HEIGHT + 0.18
    draw_heading(
        axes, COLUMNS[1] + 0.02, y, "Mapper.add_keyframe", middle(2) + clear, "every keyframe: mapping/mapper.py"
    )


def draw_window(axes: Axes) -> None:
    """Draw the shared data: a cell for each table under the title."""
    width = COLUMNS[4] + BOX_WIDTH - COLUMNS[0]
    draw_box(axes, (COLUMNS[0], WINDOW), (width, WINDOW_HEIGHT), STORE, DATA)
    centre = WINDOW + WINDOW_HEIGHT / 2
    axes.text(middle(0), centre + 0.1, "KeyframeWindow", ha="center", va="center", weight="bold", size=9, color=INK)
    axes.text(middle(0), centre - 0.1, "window/", ha="center", va="center", family="monospace", size=7, color=FAINT)
    for column, (name, what) in enumerate(STORES, start=1):
        axes.text(middle(column), centre + 0.2, name, ha="center", va="center", color=DATA)
        axes.text(middle(column), centre - 0.1, what, ha="center", va="center", color=INK, linespacing=1.3)


def draw_arrows(axes: Axes) -> None:
    """Draw the arrows between the steps."""

    def beside(row: float, source: int, target: int) -> None:
        edge = BOX_WIDTH / 2 if target > source else -BOX_WIDTH / 2
        y = row + BOX_HEIGHT / 2
        draw_arrow(axes, (middle(source) + edge, y), (middle(target) - edge, y))

    beside(CALLER, 0, 1)
    for source, target in ((1, 0), (1, 2), (2, 3), (3, 4)):
        beside(EVERY_IMAGE, source, target)
    for source in (4, 3, 2):
        beside(EVERY_KEYFRAME, source, source - 1)
    draw_arrow(axes, (middle(1), CALLER), (middle(1), EVERY_IMAGE + BOX_HEIGHT))
    draw_arrow(axes, (middle(4), PANEL_TOP), (middle(4), CALLER), "OdometryStatus")
    draw_arrow(axes, (middle(4), EVERY_IMAGE), (middle(4), EVERY_KEYFRAME + BOX_HEIGHT), "yes: Frame")
    draw_arrow(axes, (middle(2), EVERY_KEYFRAME + BOX_HEIGHT), (middle(2), EVERY_IMAGE))
    draw_arrow(axes, (middle(0), EVERY_IMAGE), (middle(0), WINDOW + WINDOW_HEIGHT), "begins it")
    for column in range(1, 5):
        draw_arrow(axes, (middle(column), EVERY_KEYFRAME), (middle(column), WINDOW + WINDOW_HEIGHT), style="<|-|>")


def main() -> None:
    """Write architecture.svg."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images")
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, HEIGHT))
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(0, HEIGHT))
        axes.set_axis_off()
        draw_groups(axes)
        draw_window(axes)
        draw_arrows(axes)
        for step in STEPS:
            draw_step(axes, step)
        figure.savefig(folder / "architecture.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    main()
