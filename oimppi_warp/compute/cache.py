"""Disk cache of computed arrays, keyed by the content that they depend on."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_LARGEST = 2_000_000_000
"""Size of the stored files above which those that were not used for longest are removed [B]."""
_OURS = re.compile(r"\w+-[0-9a-f]{24}(-sensing)?\.np[yz](\.\d+\.part)?")
"""Names of the files stored here: the kind, the hash of what it depends on, and the process that is writing it."""
_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def source_content(*places: str) -> bytes:
    """Returns a hash of source files of the package, so that results of other versions of the code are not reused.

    Args:
        *places: Files or folders below the package, such as ``"kernels/fields"``.
    """
    digest = hashlib.sha256()
    for place in places:
        path = _PACKAGE / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.relative_to(_PACKAGE).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.digest()


def content_of(*parts: object) -> str:
    """Returns a hash of arrays and numbers, and of the code that computes fields."""
    digest = hashlib.sha256(source_content("kernels/fields", "kernels/geometry.py", "geometry/pose_grid.py"))
    for part in parts:
        digest.update(np.ascontiguousarray(np.asarray(part, dtype=np.float64).round(9) + 0.0).tobytes())
        digest.update(b"|")
    return digest.hexdigest()[:24]


def content_of_data(*parts: object) -> str:
    """Returns an exact hash of data: dataclasses, tuples, arrays, numbers, strings and ``None``, each with its type.

    Raises:
        TypeError: A part, or something in it, is of another type.
    """
    digest = hashlib.sha256()
    for part in parts:
        _feed(digest, part)
    return digest.hexdigest()[:24]


def _feed(digest: hashlib._Hash, part: object) -> None:
    """Adds a value to a digest in an unambiguous encoding."""
    if is_dataclass(part) and not isinstance(part, type):
        names = [field.name for field in fields(part)]
        digest.update(f"{type(part).__name__}({','.join(names)})".encode())
        for name in names:
            _feed(digest, getattr(part, name))
    elif isinstance(part, tuple):
        digest.update(f"tuple {len(part)}:".encode())
        for each in part:
            _feed(digest, each)
    elif isinstance(part, np.ndarray):
        digest.update(f"array {part.dtype.str} {part.shape}:".encode())
        digest.update(np.ascontiguousarray(part).tobytes())
    elif isinstance(part, bytes):
        digest.update(f"bytes {len(part)}:".encode())
        digest.update(part)
    elif part is None or isinstance(part, str | bool | int | float | np.generic):
        part = part.item() if isinstance(part, np.generic) else part
        words = repr(part).encode()
        digest.update(f"{type(part).__name__} {len(words)}:".encode())
        digest.update(words)
    else:
        raise TypeError(f"a {type(part).__name__} cannot be hashed as data")


def cache_folder() -> Path:
    """Returns the folder of computed fields: ``$OIMPPI_CACHE``, or ``oimppi-warp`` in the user's cache folder."""
    base = os.environ.get("OIMPPI_CACHE")
    return Path(base) if base else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "oimppi-warp"


def cached(name: str, content: str, compute: Callable[[], np.ndarray]) -> np.ndarray:
    """Returns the array that ``compute`` makes, from the cache if it is stored there."""
    file = cache_folder() / f"{name}-{content}.npy"
    try:
        values = np.load(file)
    except (OSError, ValueError, EOFError):
        pass  # missing or truncated: compute it again
    else:
        touch(file)
        return values
    values = compute()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        partial = file.with_name(f"{file.name}.{os.getpid()}.part")
        with partial.open("wb") as stream:
            np.save(stream, values)
        partial.replace(file)
        make_room(file.parent)
    except OSError:
        return values  # with an unwritable cache the run is slower, but does not fail
    return values


def store_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Writes arrays by their names to one file of the cache folder, which appears there once it is complete.

    Raises:
        OSError: The folder cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_name(f"{file.name}.{os.getpid()}.part")
    with partial.open("wb") as stream:
        np.savez(stream, **arrays)
    partial.replace(file)
    make_room(file.parent)


def touch(file: Path) -> None:
    """Notes that a stored file is in use."""
    with suppress(OSError):
        os.utime(file)


def make_room(folder: Path) -> None:
    """Removes the stored files that were not used for longest, until the others are no larger than :data:`_LARGEST`."""
    found = []
    for file in folder.iterdir():
        if _OURS.fullmatch(file.name):
            with suppress(FileNotFoundError):  # another process removes them too
                found.append((file.stat(), file))
    excess = sum(about.st_size for about, _ in found) - _LARGEST
    for about, file in sorted(found, key=lambda each: each[0].st_mtime):
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= about.st_size
