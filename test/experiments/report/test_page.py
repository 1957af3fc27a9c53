# SPDX-License-Identifier: BSD-3-Clause
"""The report of a study: its numbers, its files, and the page in a browser."""

import csv
import html
import io
import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

from ceiling_dso_ros.experiments.report.page import REPORT, write_report
from ceiling_dso_ros.experiments.report.study import read_study
from ceiling_dso_ros.experiments.report.tables import study_tables
from ceiling_dso_ros.io.errors import InputError

pytestmark = pytest.mark.long

FIGURES = {
    *(f"{kind}_{sequence}" for kind in ("trajectories_by_rate", "trajectories_by_window", "error") for sequence in
      ("square", "loops")),
    "boxes", "speed_factor",
}  # fmt: skip
TABLES = ("time", "keyframes", "errors", "changes", "failures", "runs")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


# What the page measures of itself becomes a title, which --dump-dom prints.
MEASURE = """
const element = document.documentElement, edge = element.clientWidth + 1;
const boxes = selector => [...document.querySelectorAll(selector)].map(each => each.getBoundingClientRect());
parent.document.title = [
    "width", element.scrollWidth,
    "wide", boxes("figure, figcaption, p, h1, h2, .scroll").filter(box => box.right > edge).length,
    "flat", boxes("figure svg").filter(box => box.height < 100).length,
    "loaded", performance.getEntriesByType("resource").length,
    "errors", document.querySelectorAll("parsererror").length,
].join(" ");
"""


class Page(HTMLParser):
    """Elements and links of a page."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.links, self.sources = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.elements.append((tag, values.get("id")))
        self.links += [values["href"]] if tag == "a" else []
        self.sources += [values[name] for name in ("src", "srcset", "data") if name in values]


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def rows_in(table):
    return rows_of(table.as_csv().decode())


@pytest.fixture(scope="module")
def study(made_up):
    """With its report."""
    made = made_up(failing=(3,))
    write_report(made)
    return made


def test_the_page_has_everything_and_needs_nothing_else(study):
    text = (study.folder / REPORT).read_text()
    page = Page(text)
    assert {identity for tag, identity in page.elements if tag == "figure"} == FIGURES
    assert [identity for tag, identity in page.elements if tag == "table"] == [*TABLES]
    assert [tag for tag, _ in page.elements].count("svg") == len(FIGURES)
    assert page.sources == []
    assert not re.search(r"@import|<script|<link|url\((?!#)", text)
    assert all((study.folder / link).exists() for link in page.links)
    assert {f"runs/{run.name}/" for run in study.runs} <= {*page.links}
    assert "&lt;&amp;&gt; waiting" in text
    assert (study.folder / "tables" / "time.tex").read_text().startswith("\\begin{tabular}")
    first = rows_of((study.folder / "tables" / "failures.csv").read_text())[0]
    assert (first["what happened"], first["last words"].split(";")[0]) == ("hung", "not done after 7200 s")


def test_the_same_study_gives_the_same_bytes(study):
    first = (study.folder / REPORT).read_bytes()
    assert write_report(read_study(study.folder)).read_bytes() == first


def test_tables_have_the_numbers_of_the_runs(made_up):
    study = made_up(seeds=3)
    tables = {table.name: rows_in(table) for table in study_tables(study)}
    shares = tables["keyframes"]
    assert [(row["image size"], row["rate"]) for row in shares][:2] == [("848x480", "3 Hz"), ("848x480", "6 Hz")]
    assert {row["5 keyframes"] for row in shares if row["rate"] == "15 Hz"} == {"0.2 [0.2, 0.2]"}
    changes = tables["changes"]
    assert len(changes) == 23
    slow = next(row for row in changes if row["combination"] == "848x480, 3 Hz, 7 keyframes")
    ratio, low, high = map(float, re.findall(r"[\d.]+", slow["time for an image"]))
    assert low <= ratio <= high
    assert 2.0 < low < high < 2.6  # (12 + 7 + 30) / (12 + 7 + 3)
    lost = tables["failures"]
    assert {row["what happened"] for row in lost} == {"lost 1 times"}
    assert len(lost) == 2 * 3 * 3


def test_no_study(tmp_path):
    with pytest.raises(InputError, match="give the folder of `sweep --out`"):
        read_study(tmp_path)


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: scripts/bootstrap --tests installs it")
@pytest.mark.parametrize("width", [400, 1000])
def test_in_a_browser_it_fits_and_loads_nothing(study, tmp_path, width):
    report = study.folder / REPORT
    probe = tmp_path / "probe.html"
    # A window of Chromium is at least 500 pixels wide, a frame in it may be narrower.
    framed = html.escape(report.read_text().replace("</body>", f"<script>{MEASURE}</script></body>"))
    style = f"width:{width}px;height:900px;border:0"
    probe.write_text(f'<!DOCTYPE html><title></title><iframe style="{style}" srcdoc="{framed}"></iframe>')
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
        "--window-size=1200,900", "--dump-dom", probe.as_uri(),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    title = re.search("<title>(.*?)</title>", result.stdout)[1]
    found = dict(zip(title.split()[::2], map(int, title.split()[1::2])))
    assert found.pop("width") <= width
    assert found == {"wide": 0, "flat": 0, "loaded": 0, "errors": 0}
