# SPDX-License-Identifier: BSD-3-Clause
"""The paper's figures 4 to 11. A rate, a size or a window has the same colour in all of them."""

import io
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ceiling_dso_ros.evaluation.figures import COLOURS, METADATA, REFERENCE_COLOUR, STYLE
from ceiling_dso_ros.experiments.report.study import Combination, Study, StudyRun

REAL_TIME_COLOUR = "#009E73"
DIMENSIONS = ("rate_hz", "size", "window")
LABELS: Dict[str, Callable[[Any], str]] = {
    "rate_hz": lambda value: f"{value:g} Hz",
    "size": str,
    "window": lambda value: f"{value} keyframes",
}
TITLES = {"rate_hz": "rate", "size": "image size", "window": "window"}
FIRST_COLOUR = {"rate_hz": 0, "window": 2, "size": 4}


@dataclass(frozen=True)
class StudyFigure:
    """A figure of the report.

    Attributes:
        name: of its file, without the ending.
        caption: what it shows.
        svg: an SVG file; the same study gives the same bytes.
    """

    name: str
    caption: str
    svg: bytes


def study_figures(study: Study) -> List[StudyFigure]:
    """All figures, for the baseline's values of the dimensions that are not the paper's."""
    base, figures = study.baseline, []

    def add(name: str, caption: str, draw: Callable[[], Figure]) -> None:
        with mpl.rc_context(STYLE):
            content = io.BytesIO()
            draw().savefig(content, format="svg", metadata=METADATA[".svg"])
        figures.append(StudyFigure(name, caption, content.getvalue()))

    for number, sequence in enumerate(study.sequences):
        add(
            f"trajectories_by_rate_{sequence}",
            f"{_as(4 + number, number)}Trajectories of {sequence} by image size and rate, {base.window} keyframes.",
            lambda sequence=sequence: _trajectories(study, sequence, "rate_hz"),  # type: ignore[misc]
        )
    for number, sequence in enumerate(study.sequences):
        add(
            f"trajectories_by_window_{sequence}",
            f"{_as(6 + number, number)}Trajectories of {sequence} by image size and window, {base.rate_hz:g} Hz.",
            lambda sequence=sequence: _trajectories(study, sequence, "window"),  # type: ignore[misc]
        )
    for number, sequence in enumerate(study.sequences):
        add(
            f"error_{sequence}",
            f"{_as(8 + number, number)}Position error after alignment on {sequence} over the distance travelled; one "
            f"thing is changed against {base}.",
            lambda sequence=sequence: _errors(study, sequence),  # type: ignore[misc]
        )
    add(
        "boxes",
        "As the paper's figure 10. Position errors of all combinations, of all drives and seeds (quartiles, whiskers "
        f"1.5 times their distance), by the median of {study.sequences[-1]}, and the time for the images of a second; "
        "real time is left of the line.",
        lambda: _boxes(study),
    )
    add(
        "speed_factor",
        "As the paper's figure 11. Speed factor 1 / (t f), the mean over sequences and sizes; above the line the "
        "odometry is faster than the camera.",
        lambda: _speed_factors(study),
    )
    return figures


def _as(paper: int, number: int) -> str:
    return f"As the paper's figure {paper}. " if number < 2 else ""


def _colour(study: Study, dimension: str, value: Any) -> str:  # noqa: ANN401
    index = study.values(dimension).index(value)
    return COLOURS[(FIRST_COLOUR[dimension] + index) % len(COLOURS)]


def _changed(study: Study, dimension: str, value: Any) -> Combination:  # noqa: ANN401
    return replace(study.baseline, **{dimension: value})


def _first(runs: Sequence[StudyRun]) -> List[StudyRun]:
    """The first run that can be drawn."""
    return [run for run in runs if run.evaluation is not None][:1]


def _trajectories(study: Study, sequence: str, dimension: str) -> Figure:
    """From above: a panel for each size, a line for each rate or window."""
    sizes = study.values("size")
    figure = Figure(figsize=(3.6 * max(2, len(sizes)), 3.8), layout="constrained")
    panels = figure.subplots(1, len(sizes), squeeze=False, sharex=True, sharey=True)[0]
    for axes, size in zip(panels, sizes):
        axes.set(title=size, xlabel="x [m]", ylabel="y [m]")
        for run in [run for run in study.runs if run.sequence == sequence and run.reference is not None][:1]:
            assert run.reference is not None
            x, y, _ = run.reference.positions.T
            axes.plot(x, y, color=REFERENCE_COLOUR, linewidth=2.6, label="reference")
        for value in study.values(dimension):
            combination = replace(_changed(study, dimension, value), size=size)
            for run in _first(study.of(combination, sequence)):
                assert run.evaluation is not None
                x, y = run.evaluation.aligned[:, :2, 3].T
                label = LABELS[dimension](value)
                axes.plot(x, y, color=_colour(study, dimension, value), linewidth=1.1, label=label)
        axes.set_aspect("equal", adjustable="box")
    _legend(figure, panels)
    return figure


def _errors(study: Study, sequence: str) -> Figure:
    """The error over the distance, a panel for each dimension."""
    figure = Figure(figsize=(7.2, 7.4), layout="constrained")
    panels = figure.subplots(len(DIMENSIONS), 1, sharex=True)
    for axes, dimension in zip(panels, DIMENSIONS):
        axes.set(title=f"by {TITLES[dimension]}", ylabel="position error [mm]")
        for value in study.values(dimension):
            for run in _first(study.of(_changed(study, dimension, value), sequence)):
                assert run.evaluation is not None
                errors_mm = 1e3 * run.evaluation.position_errors_m
                axes.plot(
                    run.evaluation.travelled_m, errors_mm, color=_colour(study, dimension, value), linewidth=0.9,
                    label=LABELS[dimension](value),
                )  # fmt: skip
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        if axes.lines:
            axes.legend(ncols=4, loc="upper left", fontsize=7)
    panels[-1].set_xlabel("distance travelled [m]")
    return figure


def _boxes(study: Study) -> Figure:
    """Box plots of all combinations, and the time that the images of a second take."""
    last = study.sequences[-1]
    errors = {each: {s: _pooled_mm(study, each, s) for s in study.sequences} for each in _of_variant(study)}
    ranked = sorted(
        errors, key=lambda each: float(np.median(errors[each][last])) if len(errors[each][last]) else np.inf
    )
    figure = Figure(figsize=(7.6, 1.6 + 0.3 * len(ranked)), layout="constrained")
    boxes, times = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [3, 1.3]})
    height = 0.8 / len(study.sequences)
    for place, combination in enumerate(ranked):
        for number, sequence in enumerate(study.sequences):
            values = errors[combination][sequence]
            if not len(values):
                continue
            where = place + (number - (len(study.sequences) - 1) / 2) * height
            drawn = boxes.boxplot(
                values, vert=False, positions=[where], widths=0.8 * height, showfliers=False, patch_artist=True,
                manage_ticks=False, medianprops={"color": "black"},
            )  # fmt: skip
            drawn["boxes"][0].set_facecolor(COLOURS[number % len(COLOURS)])
        seconds_ms = study.numbers("frame_ms", combination)
        if seconds_ms:
            times.barh(place, float(np.mean(seconds_ms)) * combination.rate_hz, 0.6, color=REFERENCE_COLOUR)
    boxes.set_yticks(range(len(ranked)), [_short(each) for each in ranked], fontsize=7)
    boxes.set(xlabel="position error [mm]", xscale="log")
    boxes.axhline((len(ranked) - 1) / 2, color="#D55E00", linestyle="--", linewidth=0.8)
    boxes.invert_yaxis()
    times.axvline(1000.0, color=REAL_TIME_COLOUR)
    times.set_xlabel("ms for a second")
    patches = [Patch(color=COLOURS[i % len(COLOURS)], label=name) for i, name in enumerate(study.sequences)]
    figure.legend(handles=patches, loc="outside lower center", ncols=3)
    return figure


def _speed_factors(study: Study) -> Figure:
    """Bars by rate, one for each window."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot(ylabel="speed factor", xlabel="rate", yscale="log")
    windows, rates = study.values("window"), study.values("rate_hz")
    width = 0.8 / len(windows)
    for number, window in enumerate(windows):
        for place, rate_hz in enumerate(rates):
            chosen = [each for each in _of_variant(study) if (each.window, each.rate_hz) == (window, rate_hz)]
            factors = [1e3 / (ms * rate_hz) for each in chosen for ms in study.numbers("frame_ms", each) if rate_hz]
            if factors:
                where = place + (number - (len(windows) - 1) / 2) * width
                bar = axes.bar(where, np.mean(factors), 0.9 * width, color=_colour(study, "window", window))
                axes.bar_label(bar, fmt="%.2g", fontsize=7)
    axes.set_xticks(range(len(rates)), [LABELS["rate_hz"](each) for each in rates])
    axes.axhline(1.0, color="#D55E00", linestyle="--")
    axes.margins(y=0.15)
    patches = [Patch(color=_colour(study, "window", each), label=LABELS["window"](each)) for each in windows]
    figure.legend(handles=patches, loc="outside lower center", ncols=4)
    return figure


def _of_variant(study: Study) -> List[Combination]:
    return [each for each in study.combinations if each.variant == study.baseline.variant]


def _pooled_mm(study: Study, combination: Combination, sequence: str) -> np.ndarray:
    """Position errors of all runs, millimetres."""
    evaluations = [run.evaluation for run in study.of(combination, sequence)]
    return np.concatenate([np.zeros(0), *(1e3 * each.position_errors_m for each in evaluations if each is not None)])


def _short(combination: Combination) -> str:
    return f"I {combination.size}  F {combination.rate_hz:g}  W {combination.window}"


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels, below them."""
    entries: Dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            entries.setdefault(label, handle)
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=6)
