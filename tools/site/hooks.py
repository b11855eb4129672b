"""Hooks of the documentation site: links that leave ``docs/`` lead to pages of those files, and links whose text is
the file name of a page get the page's title; formulas and flowcharts.

The pages in ``docs/`` are written for the forge, where ``../kernels/pushing.py`` is a file of the repository. On the
site, each such file is a page below ``source/``; ``CONTRIBUTING.md`` and ``CHANGELOG.md`` are pages beside the others.
"""

from __future__ import annotations

import json
import os
import posixpath
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import latex2mathml.converter
from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads this file by its path

from diagrams import flowchart

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
STYLE = "site.css"
"""Style sheet, in this folder."""
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Pages of the site by the files at the top level that they are made of, or that they stand for."""
LANGUAGES = {".py": "python", ".toml": "toml", ".usda": "text", ".json": "json"}
"""Languages of the highlighter by the suffixes of the files."""
_DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
_NAMED = re.compile(r"\[`([\w-]+\.md)`\](?=\()")
"""A link's text that is the file name of a page."""
_LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")


class Formulas(Extension):
    """Markdown in which ``$...$`` is a formula, as on the forge; browsers draw MathML without a script."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: D102
        md.inlinePatterns.register(_Formula(r"(?<![\\\w$])\$(?=\S)([^$\n]+?)(?<=\S)\$(?![\w$])", md), "formula", 185)


class _Formula(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[Element, int, int]:
        return latex2mathml.converter.convert_to_element(m.group(1)), m.start(0), m.end(0)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Adds the formulas and the style, and lets signatures be formatted by this environment's ruff."""
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    config.extra_css.append(STYLE)
    config.markdown_extensions.append(Formulas())  # pyright: ignore[reportArgumentType]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the style, a page for each file that a page in ``docs/`` links to, and the pages from the top level."""
    files.append(File.generated(config, STYLE, content=(HERE / STYLE).read_text()))
    for source, page in PAGES.items():
        if files.get_file_from_path(page) is None:
            files.append(File.generated(config, page, content=(ROOT / source).read_text()))
    for file in list(files.documentation_pages()):
        for link, _ in _LINK.findall(file.content_string):
            target = _target(file.src_uri, link)
            if target is not None and files.get_file_from_path(_page(target)) is None:
                files.append(File.generated(config, _page(target), content=_shown(target)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: Any) -> str:
    """Redirects the links that leave ``docs/``, names pages by their titles, and draws the flowcharts."""
    here, titles = page.file.src_uri, dict(_titles(config.nav or []))

    def redirected(match: re.Match[str]) -> str:
        link, anchor = match.group(1), match.group(2) or ""
        if (target := _target(here, link)) is None:
            return match.group(0)
        return posixpath.relpath(_page(target), posixpath.dirname(here) or ".") + anchor

    if here.startswith("source/"):
        return markdown
    markdown = _NAMED.sub(lambda found: f"[*{titles.get(found.group(1), found.group(1))}*]", markdown)
    return _DIAGRAM.sub(lambda found: flowchart(found.group(1)), _LINK.sub(redirected, markdown))


def _titles(nav: list[Any]) -> Iterator[tuple[str, str]]:
    """Yields file and title of each page of the navigation."""
    for entry in nav:
        for title, content in entry.items():
            if isinstance(content, str):
                yield content, title
            else:
                yield from _titles(content)


def _target(here: str, link: str) -> str | None:
    """Returns the file of the repository that a link leads to, or None if it leads to a file that the site has."""
    if "://" in link or link.startswith(("/", "mailto:")):
        return None
    folder = "." if here in ("contributing.md", "changelog.md") else posixpath.join("docs", posixpath.dirname(here))
    target = posixpath.normpath(posixpath.join(folder, link))
    if not (ROOT / target).exists():
        return None
    return target if folder == "." or not target.startswith("docs/") or _is_result(target) else None


def _page(target: str) -> str:
    """Returns the page for a file of the repository."""
    if target in PAGES:
        return PAGES[target]
    inside = target.removeprefix("docs/")
    return inside if inside != target and not _is_result(target) else f"source/{target}.md"


def _is_result(target: str) -> bool:
    """Whether a file of the repository is, or is in, the folder of results, which is too large for the site."""
    return f"{target}/".startswith("docs/results/")


def _shown(target: str) -> str:
    """Returns a page with the content of a file or a folder."""
    path = ROOT / target
    head = f"---\nsearch:\n  exclude: true\nhide: [toc]\n---\n\n# {target}\n\n"
    if path.is_dir():
        return head + "\n".join(f"- `{name}`" for name in sorted(os.listdir(path)) if name != "__pycache__")
    if _is_result(target) and path.suffix == ".json":
        keys = json.loads(path.read_text())
        size = f"{path.stat().st_size / 1024:.0f} KiB"
        return head + f"A file of the repository, {size}, with: " + ", ".join(f"`{key}`" for key in keys)
    return f"{head}`````{LANGUAGES.get(path.suffix, 'text')}\n{path.read_text()}\n`````\n"
