"""Makes the pictures in docs/authoring.md by running the page's instructions; takes a few minutes.

Usage: ``python tools/authoring_pictures.py [FOLDER]``. The pictures are written to FOLDER, by default ``docs/images``.
"""

from __future__ import annotations

import os
import re
import shlex
import string
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # imports the package from this checkout

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from PIL import Image  # noqa: E402

from oimppi_warp.authoring.letters.letters import letter  # noqa: E402
from oimppi_warp.authoring.objects.flat_object import Box  # noqa: E402
from oimppi_warp.cli.main import main as oimppi  # noqa: E402
from oimppi_warp.plots.style import STYLE, add_rings, rendered  # noqa: E402

WIDTH = 640
"""Width of a picture [pixels]."""

COLORS = ["#34558b", "#d08c60", "#5f8a6b", "#8fb4d8", "#7d5a7f", "#efc9a5", "#b3cfa8", "#c9b3cb"]


def follow(page: str) -> None:
    """Run the page's commands and code in the current folder, except the viewer."""
    blocks = re.findall(r"^```(\w+) ?([\w.]*)\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    for kind, name, text in blocks:
        if kind == "python":
            exec(compile(text, "docs/authoring.md", "exec"), {})
        elif kind == "usda":
            Path(name).write_text(text)
        elif kind == "sh":
            for line in text.splitlines():
                command = shlex.split(line)[1:]
                if command[0] != "view" and oimppi(command) != 0:
                    raise SystemExit(f"{line}: the command failed")


def small(picture: Path, target: Path) -> None:
    """Save a picture at a width of :data:`WIDTH`, with a reduced palette."""
    image = Image.open(picture).convert("RGB")
    image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    image.quantize(96).save(target, optimize=True)


def alphabet() -> bytes:
    """Draw the letters A to Z, with each convex piece in a different colour."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 1.35))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        for number, character in enumerate(string.ascii_uppercase):
            place = np.array([0.13 * (number % 13), -0.14 * (number // 13)])
            for i, piece in enumerate(letter(character).pieces):
                corners = piece.polygon() if isinstance(piece, Box) else np.asarray(piece)
                add_rings(
                    axes, [np.vstack([corners, corners[:1]]) + place], fc=COLORS[i % len(COLORS)], ec="white", lw=0.6
                )
        axes.set(aspect="equal", xlim=(-0.07, 1.63), ylim=(-0.21, 0.07))
        axes.axis("off")
        return rendered(figure, dpi=90)


def main() -> int:
    """Make the pictures, and return exit status 0."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "docs" / "images").absolute()
    folder.mkdir(parents=True, exist_ok=True)
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as place:
        os.chdir(place)
        follow((ROOT / "docs" / "authoring.md").read_text())
        for record in sorted(Path("runs").iterdir()):
            small(record / "way.png", folder / f"authoring_{record.name}.png")
        small(Path("objects/bracket.png"), folder / "authoring_bracket.png")
        os.chdir(here)
    (folder / "authoring_letters.png").write_bytes(alphabet())
    return 0


if __name__ == "__main__":
    sys.exit(main())
