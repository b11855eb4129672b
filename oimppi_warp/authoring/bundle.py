"""Copies a USD file together with its dependencies into a scene's folder."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from pathlib import Path

from pxr import Ar, Sdf, UsdUtils

from oimppi_warp.errors import SceneError
from oimppi_warp.usd.stage import file_of

_ASSETS = "textures"


def dependencies_of(file: Path) -> list[Path]:
    """Returns a USD file and every layer, texture and mesh that it depends on.

    Raises:
        SceneError: A dependency is missing.
    """
    layers, assets, missing = UsdUtils.ComputeAllDependencies(str(file))
    if missing:
        raise _missing(missing[0], file)
    inside = [Ar.SplitPackageRelativePathOuter(asset)[0] for asset in assets]
    return sorted({path.resolve() for path in (*map(file_of, layers), *map(Path, inside))})


def copy_bundle(file: Path, folder: Path) -> Path:
    """Copies a USD file and its dependencies into a folder, keeping their paths relative to the file.

    Raises:
        SceneError: A dependency is missing or is outside the file's folder.
    """
    file = file.resolve()
    for dependency in dependencies_of(file):
        if not dependency.is_relative_to(file.parent):
            raise SceneError(
                f"the file depends on {os.path.relpath(dependency, file.parent)}, which is outside its folder",
                file=file,
                allowed="files in its own folder or below it, which can be copied with it",
                fix="move them there, or combine everything in one file with usdcat --flatten",
            )
        target = folder / dependency.relative_to(file.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(dependency, target)
    return folder / file.name


def write_flattened(layer: Sdf.Layer, file: Path, source: Path) -> None:
    """Writes a flattened stage, with its textures in a folder beside it.

    Each texture's name includes part of a hash of its contents, so textures of different files cannot be confused.

    Args:
        layer: The flattened stage; it is modified.
        file: Destination.
        source: The file it was flattened from, for error messages.

    Raises:
        SceneError: A texture is missing.
    """

    def copy_asset(path: str) -> str:
        asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
        if asset is None:
            raise _missing(os.path.relpath(path, source.parent), source)
        content = asset.GetBuffer()
        inner = Path(Ar.SplitPackageRelativePathInner(path)[1] or path)
        digest = hashlib.sha256(content).hexdigest()[:8]
        name = f"{re.sub(r'_[0-9a-f]{8}$', '', inner.stem)}_{digest}{inner.suffix}"
        (file.parent / _ASSETS).mkdir(parents=True, exist_ok=True)
        (file.parent / _ASSETS / name).write_bytes(content)
        return f"./{_ASSETS}/{name}"

    UsdUtils.ModifyAssetPaths(layer, copy_asset)
    layer.Export(str(file))


def _missing(path: str, file: Path) -> SceneError:
    fix = "correct the reference; its path is relative to the file that contains it"
    return SceneError(f"the file depends on {path}, which does not exist", file=file, fix=fix)
