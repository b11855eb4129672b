"""Scenes that differ from a shipped one in one thing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pxr import Usd, UsdGeom

from oimppi_warp.usd import shipped_scenes


def variant(folder: Path, change: Callable[[Usd.Stage], object], base: str = "task02") -> Path:
    """Write a scene that is the shipped one with a change made on top of it.

    Args:
        folder: Where to.
        change: What is done to the stage.
        base: Name of the shipped scene.
    """
    (shipped,) = [scene.path for scene in shipped_scenes() if scene.name == base]
    file = folder / "variant.usda"
    stage = Usd.Stage.CreateNew(str(file))
    stage.GetRootLayer().subLayerPaths.append(str(shipped))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(stage.GetPrimAtPath("/World"))
    change(stage)
    stage.Save()
    return file
