"""With what a result was made: the machine and a hash of our own code. It names no machine and nobody."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent
NO_PART = ("authoring", "bench", "cli", "plots", "scenes", "system", "view")
"""Folders of the package that take no part in a result: an episode imports nothing from them. Whatever is not named
here counts. Scenes count one by one, in the key of a trial."""


@cache
def code_content() -> str:
    """Hash of the source that decides results, kernels included: results of two hashes were made by different code.

    It is of this package only; methods, engines and plants of other packages are not in it.
    """
    digest = hashlib.sha256()
    files = [*_PACKAGE.rglob("*.py"), *(_PACKAGE / "kernels").glob("*.py")]  # kernels may be a link, which rglob skips
    for name, file in sorted({file.relative_to(_PACKAGE).as_posix(): file for file in files}.items()):
        if name.split("/")[0] not in NO_PART:
            digest.update(name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


@cache
def machine() -> str:
    """Processor, cores and system, in one line."""
    from oimppi_warp.compute.step import core_count
    from oimppi_warp.system.doctor import processor

    return f"{processor()}, {core_count()} cores, {platform.system()} {platform.machine()}"


def without_paths(text: str) -> str:
    """A traceback in which paths count from the package or from Python, so that it names nobody's folders."""
    for folder, name in ((_PACKAGE.parent, "."), (Path(sys.prefix), "(python)"), (Path(sys.base_prefix), "(python)")):
        text = text.replace(str(folder), name)
    return text
