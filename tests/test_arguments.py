"""No function, and no kernel, takes more than a dozen arguments by their place."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
MOST = 12
"""Most positional arguments of a function or kernel."""


def sources() -> list[Path]:
    """Every Python file of the package, the kernels and the tools, each once."""
    found = [path for folder in ("kernels", "oimppi_warp", "tools") for path in (ROOT / folder).rglob("*.py")]
    return sorted({path.resolve() for path in found})


def positional(source: str) -> Iterator[tuple[str, int, int]]:
    """Name, line and number of positional arguments of each function in a source, methods' ``self`` included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            count = len(node.args.posonlyargs) + len(node.args.args)
            yield getattr(node, "name", "lambda"), node.lineno, count


def test_no_function_or_kernel_takes_more_than_twelve_positional_arguments():
    counted = [(path, *each) for path in sources() for each in positional(path.read_text())]
    assert len(counted) > 1000 and any(count > 8 for *_, count in counted)
    too_many = [f"{path}:{line}: {name} takes {count}" for path, name, line, count in counted if count > MOST]
    assert not too_many, "more arguments than 12, group them in a wp.struct or a dataclass:\n" + "\n".join(too_many)


def test_arguments_are_counted_as_they_are_passed():
    source = "def f(a, /, b, *, c): ...\nclass C:\n    async def g(self, x): return lambda u, v, w: 0\n"
    assert list(positional(source)) == [("f", 1, 2), ("g", 3, 2), ("lambda", 3, 3)]
