"""Writes the report as one self-contained HTML page, with styles and figures embedded."""

from __future__ import annotations

import base64
from collections import Counter
from html import escape

from oimppi_warp.bench.report.markdown import facts
from oimppi_warp.bench.report.tables import Table, every_table, failures, interval, shown_methods
from oimppi_warp.bench.results import Result, ResultSet
from oimppi_warp.bench.statistics import summarize_results
from oimppi_warp.plots.style import method_colors

_STYLE = """
:root { --ink: #26323a; --soft: #5d6a73; --line: #dfe5e9; --ground: #f6f8f9; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
main { max-width: 72rem; margin: 0 auto; padding: 2.5rem 1.5rem 5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .6rem; }
h2 { font-size: 1.25rem; margin: 3rem 0 .4rem; }
p { max-width: 50rem; margin: .4rem 0; }
.note, figcaption, .facts { color: var(--soft); font-size: .88rem; }
.cards { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1.6rem 0; }
.card { background: white; border: 1px solid var(--line); border-top: 4px solid var(--color); border-radius: 6px;
  padding: .8rem 1.2rem; min-width: 11rem; }
.card b { display: block; font-size: 1.9rem; line-height: 1.2; }
.card span { color: var(--soft); font-size: .85rem; display: block; }
.scroll { overflow-x: auto; background: white; border: 1px solid var(--line); border-radius: 6px; margin-top: .8rem; }
table { border-collapse: collapse; width: 100%; font-size: .86rem; font-variant-numeric: tabular-nums; }
th, td { padding: .34rem .7rem; text-align: right; white-space: nowrap; }
th { color: var(--soft); font-weight: 600; border-bottom: 1px solid var(--line); vertical-align: bottom; }
th:nth-child(-n+2), td:nth-child(-n+2) { text-align: left; }
tr.first td { border-top: 1px solid var(--line); }
.dot { display: inline-block; width: .6rem; height: .6rem; border-radius: 50%; margin-right: .45rem; }
figure { margin: 1.2rem 0 0; background: white; border: 1px solid var(--line); border-radius: 6px; padding: 1rem; }
figure img { display: block; max-width: 100%; margin: 0 auto; }
figcaption { margin-top: .5rem; }
details { background: white; border: 1px solid var(--line); border-radius: 6px;
  margin-top: .5rem; padding: .5rem .9rem; }
summary { cursor: pointer; }
summary small { color: var(--soft); }
pre { overflow-x: auto; background: var(--ground); padding: .6rem .8rem; border-radius: 4px; font-size: .8rem; }
ul.causes { columns: 2 22rem; padding-left: 1.2rem; }
"""


def write_page(results: ResultSet, pictures: dict[str, tuple[str, bytes]]) -> str:
    """Returns the whole page as HTML.

    Args:
        results: The results to report.
        pictures: Caption and SVG of each figure, by name.
    """
    parts = [f"<h1>{escape(results.title)}</h1>"]
    parts += [f'<p class="facts">{_plain(fact)}</p>' for fact in facts(results)]
    colors = method_colors(shown_methods(results))
    dots = {method.upper(): _dot(color) for method, color in colors.items()}
    parts.append(_cards(results, colors))
    tables = every_table(results)
    figures = {name: _figure(*picture) for name, picture in pictures.items()}
    for table in tables:
        parts.append(_table(table, dots))
        if table is tables[0]:
            parts.append(figures.pop("success", ""))
    parts += ["<h2>Errors and plan times</h2>", figures.pop("errors", ""), figures.pop("plan_times", "")]
    parts += ["<h2>Paths of the object</h2>", *figures.values()]
    parts.append(_failures(results, dots))
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(results.title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body><main>\n{body}\n</main></body>\n"
        "</html>\n"
    )


def _plain(text: str) -> str:
    """Converts a Markdown sentence with emphasis and code to HTML."""
    found = escape(text, quote=False)
    for mark, tag in (("**", "b"), ("`", "code")):
        pieces = found.split(mark)
        found = "".join(f"<{tag}>{piece}</{tag}>" if index % 2 else piece for index, piece in enumerate(pieces))
    return found


def _cards(results: ResultSet, colors: dict[str, str]) -> str:
    """Shows each method's overall success rate in large type."""
    cards = []
    for method, color in colors.items():
        stats = summarize_results(results.of(method=method))
        tight = f"tight: {100 * stats.tight.share:.0f} %" if stats.tight_counts else "tight: not tested"
        cards.append(
            f'<div class="card" style="--color: {color}">{escape(method.upper())}'
            f"<b>{100 * stats.success.share:.0f} %</b>"
            f"<span>{stats.success.count} of {stats.success.total}, 95 % interval {interval(stats.success)}</span>"
            f"<span>{tight}</span></div>"
        )
    return f'<div class="cards">{"".join(cards)}</div>'


def _table(table: Table, dots: dict[str, str]) -> str:
    """Formats a table; ``dots`` are inserted before the cells that match their keys."""
    head = "".join(f"<th>{escape(name)}</th>" for name in table.header)
    rows, last = [], None
    for row in table.rows:
        cells = "".join(f"<td>{dots.get(cell, '')}{escape(cell)}</td>" for cell in row)
        rows.append(f'<tr class="first">{cells}</tr>' if row[0] != last else f"<tr>{cells}</tr>")
        last = row[0]
    return (
        f'<h2>{escape(table.title)}</h2>\n<p class="note">{escape(table.note)}</p>\n<div class="scroll"><table>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>"
    )


def _dot(color: str) -> str:
    return f'<span class="dot" style="background: {color}"></span>'


def _figure(caption: str, picture: bytes) -> str:
    data = base64.b64encode(picture).decode()
    text = escape(caption)
    image = f'<img src="data:image/svg+xml;base64,{data}" alt="{text}">'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def _failures(results: ResultSet, dots: dict[str, str]) -> str:
    found = failures(results)
    if not found:
        return "<h2>Failures</h2>\n<p>None.</p>"
    causes = Counter((result.cause, result.run.method) for result in found)
    items = [
        f"<li>{escape(cause)}: {count} of {escape(method.upper())}</li>"
        for (cause, method), count in causes.most_common()
    ]
    intro = "Causes are inferred from the logs. Each command reruns its trial with the same result."
    return f'<h2>Failures</h2>\n<p class="note">{intro}</p>\n<ul class="causes">{"".join(items)}</ul>\n' + "\n".join(
        _failure(result, dots[result.run.method.upper()]) for result in found
    )


def _failure(result: Result, dot: str) -> str:
    trace = f"<pre>{escape(result.error)}</pre>" if result.error else ""
    head = f"{dot}{escape(result.task)}, {escape(result.run.method.upper())}, start {result.number}"
    return (
        f"<details><summary>{head}: {escape(result.cause)} <small>{escape(result.evidence)}</small></summary>"
        f"<pre>{escape(result.command)}</pre>{trace}</details>"
    )
