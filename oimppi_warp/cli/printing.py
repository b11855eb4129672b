"""Printing of named rows: as a table on a terminal, otherwise one line per row, for other programs to read."""

from __future__ import annotations

import sys
from collections.abc import Mapping


def print_rows(rows: Mapping[str, str], *, name_style: str = "dim") -> None:
    """Prints rows of a name and a text; on a terminal, long texts are wrapped beside their names.

    Args:
        rows: Texts by name, with Rich's markup.
        name_style: Style of the names.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    if not sys.stdout.isatty():
        width = max(map(len, rows), default=0)
        for name, text in rows.items():
            print(f"{name:{width}}  {Text.from_markup(text).plain}".rstrip())
        return
    table = Table.grid(padding=(0, 2))
    for name, text in rows.items():
        table.add_row(f"[{name_style}]{name}", text)
    Console(highlight=False).print(table)
