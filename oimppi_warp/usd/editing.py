"""Converts a scene back to a stage: its file with everything where the scene has it, to be saved or displayed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from oimppi_warp.compute.cache import content_of_data
from oimppi_warp.errors import SceneError
from oimppi_warp.observation import planar_transform
from oimppi_warp.scene import Collider, Obstacle, PushedObject, Scene, Tolerance
from oimppi_warp.usd.collider_prims import define_collider
from oimppi_warp.usd.conversion.units import editable_prims
from oimppi_warp.usd.frames import scales, transform
from oimppi_warp.usd.stage import SceneStage

_SAVED = 1e-5
"""Tolerance for numbers that were written to a file and read back."""

_TASK = {"goal": "goal", "tolerance": "tolerance", "tight_tolerance": "tightTolerance", "spread": "spread"}
"""Scene fields by the attribute of OimppiTaskAPI that stores them."""


def save_scene(scene: Scene, file: str | Path) -> Path:
    """Writes the current scene to one self-contained file.

    It writes the start, goal and tolerances, the object, and obstacles that were moved, changed, added or removed.
    Robot, table and gravity are kept as they are in the scene's file.

    Args:
        scene: The task.
        file: Destination, ``.usda`` or ``.usdc``.

    Raises:
        SceneError: The file cannot be written, or a change to the scene cannot be expressed in it.
    """
    from oimppi_warp.usd import load_scene

    file = Path(file)
    if file.suffix not in (".usda", ".usdc"):
        raise SceneError(
            f"{file.name} is not a valid name for a scene", file=file, allowed="a name that ends in .usda or .usdc"
        )
    stage = _edited(scene, SceneStage(scene.file), load_scene(scene.file))
    partial = file.with_name(f"{file.stem}.part{file.suffix}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if not stage.GetRootLayer().Export(str(partial)):
            raise OSError("OpenUSD could not export it")
        reloaded = load_scene(partial)
        lost = next(_differences(scene, reloaded), None)
        if lost is not None:
            raise SceneError(
                f"a change to {lost} cannot be saved",
                file=file,
                allowed="changes to start, goal, tolerances, obstacles and object",
                fix="edit the scene's file instead",
            )
        partial.replace(file)
    except (OSError, RuntimeError) as error:
        raise SceneError(f"the scene cannot be written ({error})", file=file, allowed="a writable folder") from error
    finally:
        partial.unlink(missing_ok=True)
    return file


def stage_of(scene: Scene) -> Usd.Stage:
    """Returns an in-memory stage of the scene's file, with the scene's object shape and obstacles."""
    from oimppi_warp.usd import load_scene

    opened, original = SceneStage(scene.file), load_scene(scene.file)
    if content_of_data(original.object, original.obstacles) == content_of_data(scene.object, scene.obstacles):
        return opened.stage
    return _edited(scene, opened, original)


def _edited(scene: Scene, opened: SceneStage, original: Scene) -> Usd.Stage:
    """Applies the current scene to a stage of its file.

    The stage is a flattened copy: the file's own layers are shared by everything in this process that has them open.
    """
    stage = Usd.Stage.Open(opened.stage.Flatten(addSourceFileComment=False))
    list(editable_prims(stage))  # uninstances prims, so that they can be edited
    task = opened.single_prim("OimppiTaskAPI", "task", "the default prim")
    _write_task(stage.GetPrimAtPath(task.GetPath()), scene, original)
    _write_obstacles(stage, scene.obstacles, {obstacle.path: obstacle for obstacle in original.obstacles})
    _write_object(stage, scene.object, original.object)
    start = planar_transform(scene.start, scene.object.rest_height)
    _set_transform(stage.GetPrimAtPath(scene.object.path), start.tolist())
    return stage


def _write_task(task: Usd.Prim, scene: Scene, original: Scene) -> None:
    for name, attribute in _TASK.items():
        value = getattr(scene, name)
        if value != getattr(original, name):
            numbers = (value.position, value.yaw) if isinstance(value, Tolerance) else value
            vector = Gf.Vec3d if len(numbers) == 3 else Gf.Vec2d
            type_name = Sdf.ValueTypeNames.Double3 if len(numbers) == 3 else Sdf.ValueTypeNames.Double2
            task.CreateAttribute(f"oimppi:{attribute}", type_name, False).Set(vector(*numbers))


def _write_obstacles(stage: Usd.Stage, obstacles: tuple[Obstacle, ...], original: dict[str, Obstacle]) -> None:
    """Moves, recreates and removes obstacles."""
    for path in original.keys() - {obstacle.path for obstacle in obstacles}:
        stage.RemovePrim(path)
    for obstacle in obstacles:
        known = original.get(obstacle.path)
        motion = None if known is None else _motion(known.colliders, obstacle.colliders)
        if motion is None:
            root = _redefine(stage, obstacle.path)
            root.AddAppliedSchema("OimppiObstacleAPI")
            _define_colliders(stage, obstacle.path, obstacle.colliders)
        elif not Gf.IsClose(motion, Gf.Matrix4d(1.0), 1e-12):
            prim = stage.GetPrimAtPath(obstacle.path)
            _set_world(prim, UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()) * motion)


def _write_object(stage: Usd.Stage, pushed: PushedObject, original: PushedObject) -> None:
    """Gives the object its shape, mass, friction and limit surface, where they differ from the file's."""
    if pushed.path != original.path:
        stage.RemovePrim(original.path)
    same_shape = pushed.path == original.path and _is_still(_motion(original.colliders, pushed.colliders))
    if not same_shape:
        root = _redefine(stage, pushed.path)
        root.AddAppliedSchema("OimppiObjectAPI")
        UsdPhysics.RigidBodyAPI.Apply(root)
        _define_colliders(stage, pushed.path, pushed.colliders)
    prim = stage.GetPrimAtPath(pushed.path)
    weights = [(each.mass, each.center_of_mass, each.unit_inertia) for each in (pushed, original)]
    if not same_shape or content_of_data(weights[0]) != content_of_data(weights[1]):
        _write_weight(prim, pushed)
    if pushed.limit_surface_radius != original.limit_surface_radius:
        radius = prim.CreateAttribute("oimppi:limitSurfaceRadius", Sdf.ValueTypeNames.Double, False)
        radius.Set(pushed.limit_surface_radius or 0.0)
    frictions = [(each.friction, each.tool_friction) for each in (pushed, original)]
    if not same_shape or frictions[0] != frictions[1]:
        _write_friction(stage, prim, min(frictions[0]))


def _write_weight(prim: Usd.Prim, pushed: PushedObject) -> None:
    center = pushed.center_of_mass / scales(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0.0))
    prim.RemoveProperty("newton:inertia")
    weight = UsdPhysics.MassAPI.Apply(prim)
    weight.CreateMassAttr(pushed.mass)
    weight.CreateCenterOfMassAttr(Gf.Vec3f(*center.tolist()))
    moments, axes = np.zeros(3), np.eye(3)
    if pushed.unit_inertia is not None:
        moments, axes = np.linalg.eigh(pushed.mass * pushed.unit_inertia)
        axes[:, 2] *= np.linalg.det(axes)
    turn = Gf.Matrix3d(*axes.T.flatten().tolist()).ExtractRotation().GetQuat()
    weight.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    weight.CreatePrincipalAxesAttr(Gf.Quatf(turn))


def _write_friction(stage: Usd.Stage, root: Usd.Prim, friction: float) -> None:
    """Binds a material to all colliders of the object."""
    material = UsdShade.Material.Define(stage, root.GetPath().AppendChild("EditedMaterial"))
    surface = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    surface.CreateStaticFrictionAttr(friction)
    surface.CreateDynamicFrictionAttr(friction)
    for prim in Usd.PrimRange(root):
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            binding = UsdShade.MaterialBindingAPI.Apply(prim)
            binding.Bind(material, UsdShade.Tokens.strongerThanDescendants, "physics")


def _redefine(stage: Usd.Stage, path: str) -> Usd.Prim:
    """Defines an Xform in the world's frame, replacing any existing prim."""
    if not Sdf.Path.IsValidPathString(path) or not Sdf.Path(path).IsAbsoluteRootOrPrimPath():
        raise SceneError(f"{path!r} is not a valid prim path", allowed="a path such as /World/Obstacles/Box")
    stage.RemovePrim(path)
    prim = UsdGeom.Xform.Define(stage, path).GetPrim()
    _set_world(prim, Gf.Matrix4d(1.0))
    return prim


def _define_colliders(stage: Usd.Stage, root: str, colliders: tuple[Collider, ...]) -> None:
    for number, collider in enumerate(colliders):
        define_collider(stage, f"{root}/piece{number}", collider)


def rigid_motion(before: tuple[Collider, ...], after: tuple[Collider, ...]) -> np.ndarray | None:
    """Returns the rigid motion that carries one list of colliders onto another; ``None`` if there is none.

    Returns:
        Translation [m] and quaternion xyzw, shape [7].
    """
    motion = _motion(before, after)
    return None if motion is None else transform(motion)


def _motion(before: tuple[Collider, ...], after: tuple[Collider, ...]) -> Gf.Matrix4d | None:
    """Returns the one rigid motion between two lists of colliders; ``None`` if there is none."""
    if len(before) != len(after) or not before:
        return None
    motions = []
    for old, new in zip(before, after, strict=True):
        if content_of_data(replace(old, transform=new.transform, path="")) != content_of_data(replace(new, path="")):
            return None
        motions.append(_matrix(old.transform).GetInverse() * _matrix(new.transform))
    return motions[0] if all(Gf.IsClose(motion, motions[0], 1e-9) for motion in motions) else None


def _is_still(motion: Gf.Matrix4d | None) -> bool:
    return motion is not None and Gf.IsClose(motion, Gf.Matrix4d(1.0), 1e-12)


def _differences(scene: Scene, reloaded: Scene) -> Iterator[str]:
    """Yields descriptions of the parts of a scene that changed when it was saved and read back."""
    for field in fields(scene):
        if field.name not in ("file", "name", "starts") and not _equivalent(
            getattr(scene, field.name), getattr(reloaded, field.name)
        ):
            yield f"the scene's {field.name.replace('_', ' ')}"


def _equivalent(a: object, b: object) -> bool:
    """Returns whether two parts of scenes are equal up to rounding, the names of their shapes, and faces of meshes."""
    if is_dataclass(a) and type(a) is type(b):
        skipped = ("path", "faces") if isinstance(a, Collider) else ()
        return all(_equivalent(getattr(a, f.name), getattr(b, f.name)) for f in fields(a) if f.name not in skipped)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(_equivalent(each, other) for each, other in zip(a, b, strict=True))
    if isinstance(a, np.ndarray | float | int) and isinstance(b, np.ndarray | float | int):
        x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        if x.shape != y.shape:
            return False
        turned = x.shape == (7,) and np.dot(x[3:], y[3:]) < 0.0  # q and -q are the same rotation
        return bool(np.allclose(x, np.concatenate([y[:3], -y[3:]]) if turned else y, rtol=_SAVED, atol=_SAVED))
    return a == b


def _matrix(place: np.ndarray) -> Gf.Matrix4d:
    x, y, z, qx, qy, qz, qw = place.tolist()
    return Gf.Matrix4d(1.0).SetRotate(Gf.Quatd(qw, qx, qy, qz)) * Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(x, y, z))


def _set_transform(prim: Usd.Prim, place: list[float]) -> None:
    """Places a prim at a world transform (position [m], quaternion xyzw), shape [7], keeping its scale."""
    stood = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    _set_world(prim, Gf.Matrix4d(1.0).SetScale(Gf.Vec3d(*scales(stood).tolist())) * _matrix(np.array(place)))


def _set_world(prim: Usd.Prim, world: Gf.Matrix4d) -> None:
    """Gives a prim a world transform, written as translation, orientation and scale."""
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
