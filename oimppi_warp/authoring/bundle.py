"""A USD file with the files that it needs, copied beside a scene."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from pxr import UsdUtils

from oimppi_warp.errors import SceneError


def parts_of(file: Path) -> list[Path]:
    """A USD file and every layer, texture and mesh that it needs.

    Raises:
        SceneError: Something is missing.
    """
    layers, assets, missing = UsdUtils.ComputeAllDependencies(str(file))
    if missing:
        fix = "correct it; the paths of references count from the file that they stand in"
        raise SceneError(f"it needs {missing[0]}, which is not there", file=file, fix=fix)
    found = [Path(layer.realPath) for layer in layers] + [Path(asset) for asset in assets]
    return sorted({path.resolve() for path in found})


def copy_bundle(file: Path, folder: Path, name: str = "") -> Path:
    """Copy a USD file and what it needs into a folder.

    Args:
        file: The USD file.
        folder: Where to; what the file needs lies there as it does beside the file.
        name: What the file is called there; its own name, if not given.

    Raises:
        SceneError: It needs something that is missing, or that lies outside its folder.
    """
    file = file.resolve()
    for part in parts_of(file):
        if not part.is_relative_to(file.parent):
            raise SceneError(
                f"it needs {os.path.relpath(part, file.parent)}",
                file=file,
                allowed="files in its own folder or below it, which can be copied with it",
                fix="move them there, or make it one file: usdcat --flatten",
            )
        target = folder / (name or file.name) if part == file else folder / part.relative_to(file.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(part, target)
    return folder / (name or file.name)
