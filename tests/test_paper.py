"""docs/paper.md leads from each equation and algorithm line of the paper to a docstring that states it."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "paper.md"
EQUATIONS = range(1, 20)
LINES = {1: 8, 2: 8, 3: 14}
"""Lines of each algorithm."""
LINK = re.compile(r"\[`([\w.]+)`\]\(([^)#\s]+\.py)\)")
RANGE = re.compile(r"\bequations?\s+\d+\s*(?:to|through|until|-|\u2013)\s*\d+", re.IGNORECASE)


class Entry(NamedTuple):
    """A function or class that a row of the page names.

    Attributes:
        row: The row's first cell, for example ``4, phi_2`` or ``3.11``.
        name: The function or class, dotted within a class.
        file: Where it is said to be.
    """

    row: str
    name: str
    file: Path


def rows() -> dict[str, list[Entry]]:
    """The entries in the column "where" of each row of an equation or an algorithm's line."""
    found: dict[str, list[Entry]] = {}
    where = None
    for line in PAGE.read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            where = None
        elif where is None:
            where = cells.index("where") if "where" in cells else len(cells)
        elif where < len(cells) and not cells[0].startswith("-"):
            assert cells[0] not in found, f"two rows {cells[0]}"
            links = LINK.findall(cells[where])
            found[cells[0]] = [Entry(cells[0], name, (PAGE.parent / path).resolve()) for name, path in links]
    return found


ENTRIES = [entry for entries in rows().values() for entry in entries]
NAMED = [pytest.param(entry, id=f"{entry.row}: {entry.name}") for entry in ENTRIES]


@cache
def docstrings(file: Path) -> dict[str, str]:
    """Docstrings of all functions and classes of a file, methods as ``Class.method``, nested functions as well."""
    found: dict[str, str] = {}

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                found[prefix + child.name] = ast.get_docstring(child) or ""
                visit(child, f"{prefix}{child.name}." if isinstance(child, ast.ClassDef) else "")
            else:
                visit(child, prefix)

    visit(ast.parse(file.read_text()), "")
    return found


def test_every_equation_has_a_row_that_leads_to_code():
    assert [number for number in EQUATIONS if not rows().get(str(number))] == []


@pytest.mark.parametrize(("algorithm", "lines"), LINES.items())
def test_every_line_of_an_algorithm_has_a_row_that_leads_to_code(algorithm: int, lines: int):
    assert [line for line in range(1, lines + 1) if not rows().get(f"{algorithm}.{line}")] == []
    assert f"{algorithm}.{lines + 1}" not in rows()


@pytest.mark.parametrize("entry", NAMED)
def test_what_a_row_names_is_in_its_file(entry: Entry):
    assert entry.file.is_file()
    assert entry.name in docstrings(entry.file)


@pytest.mark.parametrize("entry", NAMED)
def test_its_docstring_states_the_equation_by_its_number(entry: Entry):
    text = docstrings(entry.file)[entry.name]
    if line := re.match(r"(\d+)\.\d+$", entry.row):
        assert re.search(rf"\bAlgorithm {line[1]}\b", text)
    elif equation := re.match(r"\d+", entry.row):
        assert re.search(rf"\bequation {equation[0]}\b", text, re.IGNORECASE)
        assert "``" in text, "a number, and no formula"


@pytest.mark.parametrize("folder", ["kernels", "oimppi_warp"])
def test_equations_are_named_one_by_one_and_not_as_a_range(folder: str):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    found = [f"{file.relative_to(ROOT)}: {match}" for file in files for match in RANGE.findall(file.read_text())]
    assert not found
