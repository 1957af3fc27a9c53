# SPDX-License-Identifier: BSD-3-Clause
"""The report of a study: one page without anything from elsewhere, and its figures and tables as files."""

import re
from functools import partial
from pathlib import Path
from typing import Callable, Dict

from jinja2 import Environment, StrictUndefined

from ceiling_dso_ros.experiments.report.figures import study_figures
from ceiling_dso_ros.experiments.report.study import Study
from ceiling_dso_ros.experiments.report.tables import link_of, study_tables
from ceiling_dso_ros.experiments.report.template import PAGE
from ceiling_dso_ros.io.replacing import replace_file, write_each

REPORT, FIGURES, TABLES = "report.html", "figures", "tables"


def write_report(study: Study) -> Path:
    """Write report.html, figures/*.svg and tables/*.csv and *.tex into the study's folder; returns the page's path.

    Raises:
        OutputError: a file cannot be written; all the others are.
    """
    figures, tables = study_figures(study), study_tables(study)
    inline = {figure.name: _inline(figure.svg.decode()) for figure in figures}
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    done = sum(run.is_done for run in study.runs)
    page = environment.from_string(PAGE).render(
        study=study, figures=figures, tables=tables, inline=inline, link_of=link_of, done=done,
        lost=sum(run.is_done and run.row["lost"] > 0 for run in study.runs),
    )  # fmt: skip
    contents: Dict[str, bytes] = {REPORT: page.encode()}
    contents.update({f"{FIGURES}/{figure.name}.svg": figure.svg for figure in figures})
    for table in tables:
        contents.update({f"{TABLES}/{table.name}.csv": table.as_csv(), f"{TABLES}/{table.name}.tex": table.as_latex()})
    for folder in (FIGURES, TABLES):
        (study.folder / folder).mkdir(exist_ok=True)
    writers: Dict[str, Callable[[Path], object]] = {
        name: partial(replace_file, content=content, what="the report") for name, content in contents.items()
    }
    write_each(study.folder, writers)
    return study.folder / REPORT


def _inline(svg: str) -> str:
    """The element alone; it takes the width that the page has."""
    element = svg[svg.index("<svg ") :]
    return re.sub(
        r'<svg ([^>]*?)width="[^"]*"',
        r"<svg \1",
        re.sub(r'(<svg [^>]*?)height="[^"]*" ', r"\1", element, count=1),
        count=1,
    )
