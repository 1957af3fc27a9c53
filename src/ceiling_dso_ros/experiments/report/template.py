# SPDX-License-Identifier: BSD-3-Clause
"""The page of a report, for jinja2."""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Study {{ study.folder.name }}</title>
<style>
body { font: 15px/1.45 sans-serif; color: #222; margin: 0 auto; padding: 1em; max-width: 60em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.2em; margin-top: 2em; }
figure { margin: 1.5em 0; break-inside: avoid; }
figure svg { display: block; width: 100%; min-width: 36em; height: auto; }
figcaption, .caption { color: #555; font-size: .9em; padding: .3em 0; }
.scroll { overflow-x: auto; } .caption { margin: 1.5em 0 0; }
table { border-collapse: collapse; font-size: .85em; break-inside: auto; }
th, td { text-align: right; padding: .2em .6em; border-bottom: 1px solid #ddd; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
thead th { border-bottom: 1px solid #555; vertical-align: bottom; }
.alarming { color: #a33000; font-weight: bold; }
a { color: #0072b2; }
@media print { body { max-width: none; padding: 0; } .scroll { overflow: visible; }
  figure svg { min-width: 0; } table { font-size: .6em; }
  th, td { white-space: normal; } tr { break-inside: avoid; } a { color: inherit; text-decoration: none; } }
</style>
</head>
<body>
<h1>Study {{ study.folder.name }}</h1>
<p>{{ study.runs | length }} runs of {{ study.sequences | join(", ") }}: {{ done }} are done,
<span{% if done < study.runs | length %} class="alarming"{% endif %}>{{ study.runs | length - done }} failed</span>,
<span{% if lost %} class="alarming"{% endif %}>{{ lost }} were lost</span>. Baseline: {{ study.baseline }}.
All numbers: <a href="runs.csv">runs.csv</a>; the plan: <a href="plan.yaml">plan.yaml</a>. A value leads to the
folder of its run; where it is of several runs, the numbers behind it do.</p>
<h2>Figures</h2>
{% for figure in figures %}
<figure id="{{ figure.name }}">
<div class="scroll">{{ inline[figure.name] | safe }}</div>
<figcaption>{{ figure.caption }} <a href="figures/{{ figure.name }}.svg">SVG</a></figcaption>
</figure>
{% endfor %}
<h2>Tables</h2>
{% for table in tables %}
<p class="caption">{{ table.caption }} <a href="tables/{{ table.name }}.csv">CSV</a>
<a href="tables/{{ table.name }}.tex">LaTeX</a></p>
<div class="scroll">
<table id="{{ table.name }}">
{% if table.rows %}
<thead><tr>{% for header in table.headers %}<th>{{ header }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in table.rows %}
<tr>{% for cell in row %}<td{% if cell.alarming %} class="alarming"{% endif %}>
{%- if cell.runs | length == 1 %}<a href="{{ link_of(cell.runs[0]) }}">{{ cell.text }}</a>
{%- else %}{{ cell.text }}{% for run in cell.runs %} <a href="{{ link_of(run) }}">{{ loop.index }}</a>{% endfor %}
{%- endif %}</td>{% endfor %}</tr>
{% endfor %}
</tbody>
{% endif %}
</table>
</div>
{% endfor %}
</body>
</html>
"""
