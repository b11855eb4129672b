"""Records how a result was made: the hardware and a hash of the code, without host or user names."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent
NO_PART = ("authoring", "bench", "cli", "plots", "scenes", "system", "view")
"""Folders of the package that do not affect results, since an episode imports nothing from them. All other folders
are included in the hash. Scenes are hashed individually, as part of a trial's key."""


@cache
def code_content() -> str:
    """Returns a hash of the source code that affects results, including kernels.

    It covers this package only; methods, engines and plants from other packages are not included.
    """
    digest = hashlib.sha256()
    files = [*_PACKAGE.rglob("*.py"), *(_PACKAGE / "kernels").glob("*.py")]  # rglob skips kernels if it is a link
    for name, file in sorted({file.relative_to(_PACKAGE).as_posix(): file for file in files}.items()):
        if name.split("/")[0] not in NO_PART:
            digest.update(name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


@cache
def machine() -> str:
    """Describes this machine's processor, number of cores and system in one line."""
    from oimppi_warp.compute.device import core_count
    from oimppi_warp.system.doctor import processor

    return f"{processor()}, {core_count()} cores, {platform.system()} {platform.machine()}"


def without_paths(text: str) -> str:
    """Shortens the paths in a traceback to start at the package or at Python, hiding the user's folders."""
    for folder, name in ((_PACKAGE.parent, "."), (Path(sys.prefix), "(python)"), (Path(sys.base_prefix), "(python)")):
        text = text.replace(str(folder), name)
    return text
