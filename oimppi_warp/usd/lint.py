"""Warns about content of a scene's file that is valid but probably unintended.

It finds misspelt names, differing units, files outside the folder, and implausible masses.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from pxr import Ar, Sdf, Usd, UsdGeom, UsdPhysics

from oimppi_warp.errors import Problem
from oimppi_warp.geometry.footprint import GRAVITY
from oimppi_warp.usd.inertia import given_moments
from oimppi_warp.usd.stage import SCENES, SceneStage, schema_attributes

_OURS = "oimppi"


def lint_stage(stage: SceneStage) -> Iterator[Problem]:
    """Yields warnings about a file, whether or not it can be read as a task."""
    for prim in stage.prims():
        yield from _misspelt_schemas(stage, prim)
        yield from _unused_attributes(stage, prim)
        yield from _moving_in_time(stage, prim)
        yield from _impossible_inertia(stage, prim)
        yield from _other_gravity(stage, prim)
        yield from _files_elsewhere(stage, prim)
    yield from _layers_elsewhere(stage)
    yield from _layers_in_other_units(stage)


def _misspelt_schemas(stage: SceneStage, prim: Usd.Prim) -> Iterator[Problem]:
    known = schema_attributes()
    for name in prim.GetPrimTypeInfo().GetAppliedAPISchemas():
        if name.lower().startswith(_OURS) and name not in known:
            yield stage.warning(
                f"the API schema {name} is unknown",
                prim,
                allowed=", ".join(known),
                fix=_suggestion(name, known),
            )


def _unused_attributes(stage: SceneStage, prim: Usd.Prim) -> Iterator[Problem]:
    known = schema_attributes()
    applied = prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    here = [name for schema in applied for name in known.get(schema, ())]
    everywhere = [name for names in known.values() for name in names]
    for name in (each.GetName() for each in prim.GetAuthoredProperties()):
        space = name.partition(":")[0]
        if not difflib.get_close_matches(space.lower(), [_OURS], cutoff=0.8) or ":" not in name or name in here:
            continue
        if name in everywhere:
            (owner,) = (schema for schema, names in known.items() if name in names)
            yield stage.warning(
                f"{name} has no effect on this prim",
                prim,
                allowed=f"on a prim with {owner}",
                fix="move it there, or remove it",
            )
        else:
            allowed = ", ".join(here) or "none on this prim"
            fix = _suggestion(name, here or everywhere)
            yield stage.warning(f"the attribute {name} is unknown", prim, allowed=allowed, fix=fix)


def _suggestion(name: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"did you mean {near[0]}?" if near else "remove it"


def _moving_in_time(stage: SceneStage, prim: Usd.Prim) -> Iterator[Problem]:
    if not prim.IsA(UsdGeom.Xformable) or prim.IsA(UsdGeom.Camera):
        return
    timed = [op.GetName() for op in UsdGeom.Xformable(prim).GetOrderedXformOps() if op.GetNumTimeSamples() > 0]
    if prim.IsA(UsdGeom.PointBased):
        timed += ["points"] * (UsdGeom.PointBased(prim).GetPointsAttr().GetNumTimeSamples() > 0)
    if timed:
        yield stage.warning(
            f"time samples are ignored: {', '.join(timed)}",
            prim,
            allowed="a default value",
            fix="set the intended value as the default value",
        )


def _impossible_inertia(stage: SceneStage, prim: Usd.Prim) -> Iterator[Problem]:
    inertia = given_moments(prim)
    if inertia is None:
        return
    largest = inertia.max()
    if (inertia <= 0.0).any() or largest > 1.001 * (inertia.sum() - largest):
        yield stage.warning(
            f"physics:diagonalInertia is ({', '.join(f'{moment:.4g}' for moment in inertia)}), "
            "which is physically impossible",
            prim,
            allowed="three moments above zero, none larger than the sum of the other two",
            fix="correct it, or leave it out to have it computed from the shapes and the mass",
        )


def _other_gravity(stage: SceneStage, prim: Usd.Prim) -> Iterator[Problem]:
    if not prim.IsA(UsdPhysics.Scene):
        return
    scene = UsdPhysics.Scene(prim)
    direction, magnitude = np.array(scene.GetGravityDirectionAttr().Get()), scene.GetGravityMagnitudeAttr().Get()
    down = not direction.any() or np.allclose(direction / np.linalg.norm(direction), (0.0, 0.0, -1.0), atol=1e-3)
    if not down or (magnitude >= 0.0 and abs(magnitude - GRAVITY) > 0.1):
        x, y, z = direction
        yield stage.warning(
            f"gravity is {magnitude:g} m/s^2 along ({x:g}, {y:g}, {z:g}), which the planner ignores",
            prim,
            allowed=f"{GRAVITY:g} m/s^2 downwards",
            fix="leave out physics:gravityDirection and physics:gravityMagnitude",
        )


def _files_elsewhere(stage: SceneStage, prim: Usd.Prim) -> Iterator[Problem]:
    """Yields warnings about assets, such as textures, that are missing or outside the scene's folder."""
    for attribute in prim.GetAuthoredAttributes():
        value = attribute.Get()
        for asset in (value,) if isinstance(value, Sdf.AssetPath) else value if _is_assets(value) else ():
            if not asset.path:
                continue
            if not asset.resolvedPath:
                yield stage.warning(
                    f"{attribute.GetName()} refers to a missing file: {asset.path}",
                    prim,
                    allowed="an existing file; its path is relative to the file that contains it",
                    fix="correct the path, or remove it",
                )
            elif not _belongs(stage, asset.resolvedPath):
                yield _elsewhere(stage, asset.resolvedPath, prim)


def _is_assets(value: object) -> bool:
    return isinstance(value, Sdf.AssetPathArray)


def _layers_elsewhere(stage: SceneStage) -> Iterator[Problem]:
    for file in stage.layers:
        if not _belongs(stage, str(file)):
            yield _elsewhere(stage, str(file))


def _belongs(stage: SceneStage, path: str) -> bool:
    """Returns whether a file is in the scene's folder or is shipped with the package."""
    place = Path(Ar.SplitPackageRelativePathOuter(path)[0]).resolve()
    return any(place.is_relative_to(folder.resolve()) for folder in (stage.file.parent, SCENES))


def _elsewhere(stage: SceneStage, path: str, prim: Usd.Prim | str = "") -> Problem:
    return stage.warning(
        f"a file outside the scene's folder is used: {path}",
        prim,
        allowed=f"files in {stage.file.parent}",
        fix="copy it there, so that the scene can be moved as a whole",
    )


def _layers_in_other_units(stage: SceneStage) -> Iterator[Problem]:
    """Yields warnings about referenced files whose units differ from the scene's, as USD composes them unconverted."""
    own = stage.stage.GetRootLayer().pseudoRoot
    for layer in stage.stage.GetUsedLayers():
        head = layer.pseudoRoot
        for name in ("metersPerUnit", "kilogramsPerUnit", "upAxis"):
            if layer.realPath and head.HasInfo(name) and head.GetInfo(name) != own.GetInfo(name):
                yield stage.warning(
                    f"{name} is {_plain(head.GetInfo(name))} in {layer.realPath}",
                    allowed=f"{_plain(own.GetInfo(name))}, as in the scene",
                    fix="convert that file, or scale or rotate its shapes: USD does not convert units between files",
                )


def _plain(unit: float | str) -> str:
    return unit if isinstance(unit, str) else f"{unit:g}"
