"""Draws the flowcharts of the documents as SVG, so that the site needs no script for them.

The forge draws ```` ```mermaid ```` blocks itself. Of its language, this reads what the documents use: lines such as
``a["text"] -->|"text"| b & c --> d``, from top to bottom.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass, field
from html import escape

LETTER, LINE, PADDING = 6.9, 17, 10
"""Width of a letter, height of a line of text and padding of a box [px]."""
APART, BELOW = 26, 58
"""Distance of two boxes in a row, and of two rows [px]."""
_NODE = re.compile(r'(\w+)(?:\["(.*?)"\])?')
_ARROW = re.compile(r'\s*-->\s*(?:\|"(.*?)"\|)?\s*')


@dataclass
class Box:
    """A node: its lines of text, and where it is drawn (``x``, ``y`` of its middle)."""

    lines: list[str]
    row: int = 0
    x: float = 0.0
    y: float = 0.0
    above: list[str] = field(default_factory=list)

    @property
    def width(self) -> float:
        """Returns the width [px]."""
        return LETTER * max(map(len, self.lines)) + 2 * PADDING

    @property
    def height(self) -> float:
        """Returns the height [px]."""
        return LINE * len(self.lines) + PADDING


def flowchart(text: str) -> str:
    """Returns a flowchart as SVG, on one line; `site.css` has its colours."""
    boxes, edges = _parsed(text)
    width, height = _place(boxes)
    drawn = [_arrow(boxes[a], boxes[b], label) for a, b, label in edges]
    for box in boxes.values():
        x, y = box.x - box.width / 2, box.y - box.height / 2
        drawn.append(
            f'<rect x="{x:.0f}" y="{y:.0f}" width="{box.width:.0f}" height="{box.height:.0f}" rx="5" class="box"/>'
        )
        first = box.y - LINE * (len(box.lines) - 1) / 2 + 4
        drawn += [_text(box.x, first + LINE * n, line) for n, line in enumerate(box.lines)]
    head = '<marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
    return (
        f'<svg class="diagram" role="img" width="{width:.0f}" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'xmlns="http://www.w3.org/2000/svg">'
        f'<defs>{head}<path d="M0 0 8 4 0 8z" fill="currentColor"/></marker></defs>'
        f"{''.join(drawn)}</svg>"
    )


def _parsed(text: str) -> tuple[dict[str, Box], list[tuple[str, str, str]]]:
    """Returns the boxes by name, and the edges: from, to and text."""
    boxes: dict[str, Box] = {}
    edges: list[tuple[str, str, str]] = []
    for line in text.strip().splitlines()[1:]:
        parts = _ARROW.split(line.strip())
        groups = [re.split(r"\s+&\s+", part) for part in parts[0::2]]
        names: list[list[str]] = []
        for group in groups:
            names.append([])
            for node in group:
                if (found := _NODE.fullmatch(node.strip())) is None:
                    raise ValueError(f"a flowchart of the documents has a line that cannot be drawn: {line}")
                name, label = found.groups()
                if label or name not in boxes:
                    above = boxes[name].above if name in boxes else []
                    boxes[name] = Box(textwrap.wrap(label or name, 26), above=above)
                names[-1].append(name)
        for before, after, label in zip(names, names[1:], parts[1::2], strict=False):
            for a in before:
                for b in after:
                    edges.append((a, b, label or ""))
                    if not _leads(boxes, b, a):  # an arrow back up places no box
                        boxes[b].above.append(a)
    return boxes, edges


def _leads(boxes: dict[str, Box], first: str, last: str) -> bool:
    """Returns whether a box is at the end of a way down from another."""
    return first == last or any(_leads(boxes, first, name) for name in boxes[last].above)


def _place(boxes: dict[str, Box]) -> tuple[float, float]:
    """Places the boxes in rows, each below all that lead to it, and returns width and height [px]."""
    for _ in boxes:  # the longest way down to a box decides
        for box in boxes.values():
            box.row = max((boxes[name].row + 1 for name in box.above), default=0)
    rows = [[box for box in boxes.values() if box.row == row] for row in sorted({box.row for box in boxes.values()})]
    width = max(sum(box.width + APART for box in row) for row in rows) + 2 * APART
    y = 2.0
    for row in rows:
        row.sort(key=lambda box: sum(boxes[name].x for name in box.above) / max(len(box.above), 1))
        free = (width - sum(box.width for box in row)) / len(row)
        x, height = free / 2, max(box.height for box in row)
        for box in row:
            box.x, box.y = x + box.width / 2, y + height / 2
            x += box.width + free
        y += height + BELOW
    return width, y - BELOW + 2


def _arrow(a: Box, b: Box, label: str) -> str:
    """Returns an arrow from below a box to the top of another; to one farther up, from side to side."""
    if b.y > a.y:
        x0, y0, x1, y1 = a.x, a.y + a.height / 2, b.x, b.y - b.height / 2
        middle = (y0 + y1) / 2
        ways = f"{x0:.0f} {middle:.0f} {x1:.0f} {middle:.0f}"
    else:
        side = 1 if a.x > b.x else -1
        x0, y0, x1, y1 = a.x + side * a.width / 2, a.y, b.x + side * b.width / 2, b.y
        farthest = max(x0, x1) + 60 if side > 0 else min(x0, x1) - 60
        ways = f"{farthest:.0f} {y0:.0f} {farthest:.0f} {y1:.0f}"
    path = f'<path class="edge" marker-end="url(#head)" d="M{x0:.0f} {y0:.0f}C{ways} {x1:.0f} {y1:.0f}"/>'
    return path + (_text(0.2 * x0 + 0.8 * x1, (y0 + y1) / 2 + 4, label) if label else "")


def _text(x: float, y: float, text: str) -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}">{escape(text)}</text>'
