"""Writes the report of a result set: an HTML page, and a Markdown file with its figures next to it."""

from __future__ import annotations

from pathlib import Path

from oimppi_warp.bench.report.figures import every_figure
from oimppi_warp.bench.report.markdown import write_markdown
from oimppi_warp.bench.report.page import write_page
from oimppi_warp.bench.results import ResultSet
from oimppi_warp.plots.style import rendered
from oimppi_warp.record.log import write_atomically

PAGE, MARKDOWN, PICTURES = "report.html", "report.md", "pictures"


def write_report(results: ResultSet, folder: Path) -> tuple[Path, Path]:
    """Writes the page and the Markdown into ``folder``, created if necessary, and returns these two files."""
    (folder / PICTURES).mkdir(parents=True, exist_ok=True)
    drawn = {name: (caption, rendered(figure, kind="svg")) for name, (caption, figure) in every_figure(results).items()}
    files = {name: (caption, f"{PICTURES}/{name}.svg") for name, (caption, _) in drawn.items()}
    for name, (_, picture) in drawn.items():
        write_atomically(folder / files[name][1], picture)
    write_atomically(folder / PAGE, write_page(results, drawn).encode())
    write_atomically(folder / MARKDOWN, write_markdown(results, files).encode())
    return folder / PAGE, folder / MARKDOWN
