"""The documentation site: built without a network, whole, and asking no other server for anything."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest

import oimppi_warp
import oimppi_warp.authoring

pytest.importorskip("mkdocs", reason="MkDocs is not installed")
ROOT = Path(__file__).resolve().parents[1]
NO_PROXY = "http://127.0.0.1:9"
"""An address at which nothing answers."""


class Page(HTMLParser):
    """Links, loaded files and anchors of a page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = {""}
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value is not None}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if "src" in given:
            self.loaded.append(given["src"])
        if "href" in given:
            (self.loaded if tag == "link" else self.links).append(given["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--config-file", "tools/site/mkdocs.yml"]
    offline = dict.fromkeys(("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"), NO_PROXY)
    environment = os.environ | offline | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [*command, "--site-dir", str(folder)], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {file: Page(file) for file in site.rglob("*.html") if file.name != "404.html"}


def test_every_document_is_a_page(site: Path):
    names = {path.stem for path in (ROOT / "docs").glob("*.md")} | {"contributing", "changelog"}
    assert names <= {path.stem for path in site.glob("*.html")}


def test_every_link_leads_to_a_page_and_to_a_place_on_it(site: Path, pages: dict[Path, Page]):
    broken = []
    for file, page in pages.items():
        for link in {*page.links, *page.loaded}:
            path, anchor = urldefrag(unquote(link))
            if re.match(r"[a-z]+:", path):
                continue
            target = (file.parent / path).resolve() if path else file
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file() or (target in pages and anchor not in pages[target].anchors):
                broken.append((file.relative_to(site).as_posix(), link))
    assert not broken


def test_no_page_loads_anything_from_another_server(site: Path, pages: dict[Path, Page]):
    assert [link for page in pages.values() for link in page.loaded if re.match(r"(https?:)?//", link)] == []
    for style in site.rglob("*.css"):
        assert not re.search(r"url\([\"']?(https?:)?//|@import", style.read_text())


def test_a_file_of_the_repository_is_shown_where_a_page_links_to_it(site: Path):
    assert "source/kernels/pushing.py.html" in (site / "paper.html").read_text()
    shown = re.sub(r"<[^>]*>", "", (site / "source" / "kernels" / "pushing.py.html").read_text())
    assert "def push(" in shown


def test_formulas_are_drawn_by_the_browser(site: Path):
    page = (site / "paper.html").read_text()
    assert page.count("<math") > 90
    assert not re.search(r"\$[^$<\n]*\\[a-z]+", page)


def test_flowcharts_are_drawn_without_a_script(site: Path):
    page = (site / "design.html").read_text()
    assert page.count('<svg class="diagram"') == (ROOT / "docs" / "design.md").read_text().count("```mermaid") == 2
    assert page.count('<rect x="') > 20 and "mermaid" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)


def test_every_public_name_has_its_place_in_the_python_interface(site: Path):
    anchors = Page(site / "api.html").anchors
    for name in oimppi_warp.__all__:
        assert f"oimppi_warp.{name}" in anchors, name


def test_the_search_finds_documents_and_no_source_files(site: Path):
    index = (site / "search" / "search_index.json").read_text()
    assert '"location":"faq.html' in index and '"location":"source/' not in index
