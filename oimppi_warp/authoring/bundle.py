"""A USD file with the files that it needs, brought beside a scene."""

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
    """A USD file and every layer, texture and mesh that it needs.

    Raises:
        SceneError: Something is missing.
    """
    layers, assets, missing = UsdUtils.ComputeAllDependencies(str(file))
    if missing:
        raise _missing(missing[0], file)
    inside = [Ar.SplitPackageRelativePathOuter(asset)[0] for asset in assets]
    return sorted({path.resolve() for path in (*map(file_of, layers), *map(Path, inside))})


def copy_bundle(file: Path, folder: Path) -> Path:
    """Copy a USD file and what it needs into a folder, where it lies as it does beside the file.

    Raises:
        SceneError: It needs something that is missing, or that lies outside its folder.
    """
    file = file.resolve()
    for dependency in dependencies_of(file):
        if not dependency.is_relative_to(file.parent):
            raise SceneError(
                f"it needs {os.path.relpath(dependency, file.parent)}",
                file=file,
                allowed="files in its own folder or below it, which can be copied with it",
                fix="move them there, or make it one file: usdcat --flatten",
            )
        target = folder / dependency.relative_to(file.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(dependency, target)
    return folder / file.name


def write_flattened(layer: Sdf.Layer, file: Path, source: Path) -> None:
    """Write a flattened stage, with its textures in a folder beside it.

    Their names there tell by a part of their hash what they hold, so that no two files' textures are mixed up.

    Args:
        layer: The flattened stage, which is changed.
        file: Where to.
        source: The file that it was made of, for errors.

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
    fix = "correct it; the paths of references count from the file that they stand in"
    return SceneError(f"it needs {path}, which is not there", file=file, fix=fix)
