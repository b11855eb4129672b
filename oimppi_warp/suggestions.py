"""Suggestions for a name that does not exist: the nearest of those that do."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path


def did_you_mean(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str:
    """Returns a question that suggests the nearest known name, or an empty string if none is near.

    Args:
        name: Name that does not exist.
        known: Names that do.
        cutoff: Least similarity, from 0 to 1, of a name that is suggested (:func:`difflib.get_close_matches`).
    """
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return f"did you mean {near[0]}?" if near else ""


def did_you_mean_file(file: str | Path, names: Sequence[str], endings: Sequence[str]) -> str:
    """Returns a question that suggests a file beside one that does not exist, or a name; empty if nothing is near.

    Args:
        file: The file that does not exist, as it was given.
        names: Names that may be given instead of a file.
        endings: Endings of the files that would do, such as ``".usda"``.
    """
    path = Path(os.path.expanduser(file))
    files = [each for each in sorted(path.parent.glob("*")) if each.suffix.lower() in endings and each.is_file()]
    beside = [each.name for each in files if each.name != path.name]
    forgotten = [name for name in beside if Path(name).stem == path.name]
    near = forgotten or difflib.get_close_matches(path.name, beside, n=1, cutoff=0.75)
    if near:
        return f"did you mean {path.with_name(near[0])}?"
    return did_you_mean(path.stem, names, cutoff=0.5)
