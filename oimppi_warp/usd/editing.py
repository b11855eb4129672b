"""A task saved as it stands now: the same scene with another start, goal or obstacles elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pxr import Gf, Usd, UsdGeom

from oimppi_warp.errors import SceneError
from oimppi_warp.observation import planar_transform
from oimppi_warp.scene import PlanarPose, Scene
from oimppi_warp.usd.frames import scales
from oimppi_warp.usd.stage import SceneStage


def save_scene(scene: Scene, file: str | Path, *, moves: Mapping[str, PlanarPose] | None = None) -> Path:
    """Writes a scene with its present start and goal into one file that needs no other.

    Args:
        scene: The task.
        file: Where to, ``.usda`` or ``.usdc``.
        moves: How far obstacles are moved: by their prim paths, (x [m], y [m], turn about their own centre [rad]).

    Raises:
        SceneError: The file cannot be written.
    """
    from oimppi_warp.usd import load_scene

    file = Path(file)
    if file.suffix not in (".usda", ".usdc"):
        raise SceneError(f"{file.name}: not the name of a scene", file=file, allowed="a name with .usda or .usdc")
    # A flattened copy: the layers of the file itself are shared by all in this process that have it open.
    opened = SceneStage(scene.file)
    flat = opened.stage.Flatten(addSourceFileComment=False)
    stage = Usd.Stage.Open(flat)
    task = stage.GetPrimAtPath(opened.the("OimppiTaskAPI", "task", "the scene's default prim").GetPath())
    task.GetAttribute("oimppi:goal").Set(Gf.Vec3d(*scene.goal))
    _put(stage.GetPrimAtPath(scene.object.path), planar_transform(scene.start, scene.object.rest_height).tolist())
    for path, (x, y, turn) in (moves or {}).items():
        _shift(stage.GetPrimAtPath(path), x, y, turn)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if not flat.Export(str(file)):
            raise OSError("OpenUSD refused")
    except (OSError, RuntimeError) as error:
        raise SceneError(f"the scene cannot be written ({error})", file=file, allowed="a folder to write in") from error
    load_scene(file)
    return file


def _put(prim: Usd.Prim, transform: list[float]) -> None:
    """Put a prim at a world transform [7], its scale kept."""
    x, y, z, qx, qy, qz, qw = transform
    world = Gf.Matrix4d(1.0).SetRotate(Gf.Quatd(qw, qx, qy, qz)) * Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(x, y, z))
    stood = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    _set_world(prim, Gf.Matrix4d(1.0).SetScale(Gf.Vec3d(*scales(stood).tolist())) * world)


def _shift(prim: Usd.Prim, x: float, y: float, turn: float) -> None:
    """Move a prim over the table, turned about its own origin."""
    world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    at = world.ExtractTranslation()
    about = Gf.Matrix4d(1.0).SetTranslate(-at)
    about = about * Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), turn * 180.0 / 3.141592653589793))
    _set_world(prim, world * about * Gf.Matrix4d(1.0).SetTranslate(at + Gf.Vec3d(x, y, 0.0)))


def _set_world(prim: Usd.Prim, world: Gf.Matrix4d) -> None:
    """Give a prim a world transform, written as translation, orientation and scale."""
    xform = UsdGeom.Xformable(prim)
    parent = xform.ComputeParentToWorldTransform(Usd.TimeCode.Default())
    local = Gf.Transform(world * parent.GetInverse())
    for op in xform.GetOrderedXformOps():
        prim.RemoveProperty(op.GetName())
    xform.ClearXformOpOrder()
    xform.AddTranslateOp().Set(local.GetTranslation())
    xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(local.GetRotation().GetQuat())
    scale = local.GetScale()
    if not Gf.IsClose(scale, Gf.Vec3d(1.0), 1e-9):
        xform.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(scale)
