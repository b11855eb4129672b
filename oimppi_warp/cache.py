"""Computed things kept on disk by their content, so that the next run need not compute them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

_KERNELS = Path(__file__).parent / "kernels"


@cache
def _version() -> bytes:
    """Hash of the kernels that fields are computed with: what others computed is not read again."""
    digest = hashlib.sha256()
    for name in ("geometry", "clearance", "navigation"):
        digest.update((_KERNELS / f"{name}.py").read_bytes())
    return digest.digest()


def content_of(*parts: object) -> str:
    """Hash of arrays and numbers."""
    digest = hashlib.sha256(_version())
    for part in parts:
        digest.update(np.ascontiguousarray(np.asarray(part, dtype=np.float64).round(9) + 0.0).tobytes())
        digest.update(b"|")
    return digest.hexdigest()[:24]


def cache_folder() -> Path:
    """Where computed fields are kept: ``$OIMPPI_CACHE``, or ``oimppi-warp`` in the user's cache folder."""
    base = os.environ.get("OIMPPI_CACHE")
    return Path(base) if base else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "oimppi-warp"


def cached(name: str, content: str, compute: Callable[[], np.ndarray]) -> np.ndarray:
    """The array that ``compute`` makes, from the cache if it was made before."""
    file = cache_folder() / f"{name}-{content}.npy"
    try:
        return np.load(file)
    except (OSError, ValueError, EOFError):
        pass  # not there, or cut short: make it again
    values = compute()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        partial = file.with_name(f"{file.name}.{os.getpid()}.part")
        with partial.open("wb") as stream:
            np.save(stream, values)
        partial.replace(file)
    except OSError:
        return values  # a cache that cannot be written costs time, not the run
    return values
