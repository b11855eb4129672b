"""From a USD file to a :class:`oimppi_warp.scene.Scene`; the only reader of USD in the package.

Physics is read from the standard UsdPhysics schemas; what USD has no word for, from ours (`docs/schema.md`). The
friction of a pair of shapes is the larger of their materials' coefficients, as MuJoCo combines them.
"""

from __future__ import annotations

import difflib
import hashlib
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdPhysics

from oimppi_warp.errors import SceneError
from oimppi_warp.footprint import height_range
from oimppi_warp.scene import Obstacle, PlanarPose, PushedObject, Scene, Table, Tolerance
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders, volume_and_center
from oimppi_warp.usd.robot import read_mass, read_robot
from oimppi_warp.usd.stage import SCENES, SceneStage, single, transform

__all__ = ["ShippedScene", "load_scene", "scene_content", "shipped_scenes"]

FLOATING = 1e-3
"""How far an object may stand above or in the table in the file [m]."""

_WORLD = Gf.Matrix4d(1.0)


@dataclass(frozen=True)
class ShippedScene:
    """A scene that comes with the package: its name, a line about it, and its file."""

    name: str
    title: str
    path: Path


def shipped_scenes() -> list[ShippedScene]:
    """The scenes that come with the package, in the order of their names."""
    scenes = []
    for path in sorted(SCENES.glob("*.usda")):
        layer = Sdf.Layer.FindOrOpen(str(path))
        title = layer.GetAttributeAtPath(f"/{layer.defaultPrim}.oimppi:title")
        scenes.append(ShippedScene(path.stem, title.default if title else "", path))
    return scenes


def load_scene(scene: str | Path) -> Scene:
    """Read and check a scene.

    Args:
        scene: A USD file, or the name of a shipped scene (``"task02"``).

    Raises:
        SceneError: It cannot be run; the message says what is wrong, where, what is allowed and what to do. Whether the
            arm can do the task is another question: :func:`oimppi_warp.feasibility.check_task`.
    """
    stage = SceneStage(_find(scene))
    world = stage.the("OimppiTaskAPI", "task", "the scene's default prim")
    goal = stage.numbers(world, "oimppi:goal", (3,), "(x [m], y [m], yaw [rad]) of the object's goal")
    starts = stage.numbers(world, "oimppi:starts", (-1, 3), "a list of (x [m], y [m], yaw [rad])")
    if not (np.isfinite(goal).all() and np.isfinite(starts).all()):
        raise stage.error("a goal or start that is not finite", world, allowed="x [m], y [m], yaw [rad]")
    robot = read_robot(stage)
    table = _read_table(stage)
    pushed, start = _read_object(stage, robot.tool_path)
    obstacles = tuple(_read_obstacle(stage, prim) for prim in stage.role("OimppiObstacleAPI"))
    _check_roles(stage, [robot.path, table.path, pushed.path, *(obstacle.path for obstacle in obstacles)])
    spread = stage.numbers(world, "oimppi:spread", (2,), "half widths (position [m], yaw [rad]), zero or more")
    if not (np.isfinite(spread).all() and (spread >= 0.0).all()):
        raise stage.error(f"oimppi:spread is {spread.tolist()}", world, allowed="finite numbers, zero or more")
    return Scene(
        file=stage.file,
        name=stage.file.stem,
        title=stage.text(world, "oimppi:title"),
        robot=robot,
        object=pushed,
        table=table,
        obstacles=obstacles,
        start=start,
        starts=starts if len(starts) else np.array([start]),
        spread=(float(spread[0]), float(spread[1])),
        goal=(float(goal[0]), float(goal[1]), float(goal[2])),
        tolerance=_read_tolerance(stage, world, "oimppi:tolerance"),
        tight_tolerance=_read_tolerance(stage, world, "oimppi:tightTolerance"),
    )


def scene_content(file: Path) -> str:
    """Hash of a scene's file and of every USD file that it refers to, wherever they are.

    Raises:
        SceneError: It is not USD.
    """
    opened = SceneStage(file)  # kept, because its layers live as long as it does
    files = [Path(layer.realPath) for layer in opened.stage.GetUsedLayers() if layer.realPath]
    found = sorted(hashlib.sha256(each.read_bytes()).hexdigest() for each in files)
    return hashlib.sha256("".join(found).encode()).hexdigest()[:24]


def _find(scene: str | Path) -> Path:
    """The file of a scene given by its path or its shipped name."""
    names = [path.stem for path in sorted(SCENES.glob("*.usda"))]
    if str(scene) in names:
        return SCENES / f"{scene}.usda"
    file = Path(os.path.expanduser(scene))
    if file.is_file():
        return file.resolve()
    near = difflib.get_close_matches(file.stem, names, n=1, cutoff=0.5)
    raise SceneError(
        "there is no such file",
        file=scene,
        allowed=f"a USD file, or one of {', '.join(names)}",
        fix=f"did you mean {near[0]}?" if near else "`oimppi scenes` lists the scenes that come with the package",
    )


def _read_tolerance(stage: SceneStage, world: Usd.Prim, name: str) -> Tolerance:
    position, yaw = stage.numbers(world, name, (2,), "(position [m], yaw [rad]), each more than zero")
    if not (position > 0.0 and yaw > 0.0):
        raise stage.error(f"{name} is ({position:g}, {yaw:g})", world, allowed="numbers above zero")
    return Tolerance(float(position), float(yaw))


def _read_table(stage: SceneStage) -> Table:
    prim = stage.the("OimppiTableAPI", "table", "the box that the object slides on")
    allowed = "a Cube with CollisionAPI, aligned with the world's axes (yaw 0), its top at z = 0"
    _check_static(stage, prim, "table")
    for collider in read_colliders(stage, prim, _WORLD):
        top = collider.transform[2] + collider.size[2] if collider.kind == "box" else math.nan
        if abs(top) < 1e-6 and np.allclose(np.abs(collider.transform[3:]), (0, 0, 0, 1), atol=1e-6):
            (x, y), (hx, hy) = collider.transform[:2], collider.size[:2]
            return Table(str(prim.GetPath()), (float(x - hx), float(y - hy)), (float(x + hx), float(y + hy)))
    raise stage.error("a table without a flat top at z = 0", prim, allowed=allowed)


def _read_object(stage: SceneStage, tool_path: str) -> tuple[PushedObject, PlanarPose]:
    prim = stage.the("OimppiObjectAPI", "object", "the rigid body that is to be pushed")
    if not prim.HasAPI(UsdPhysics.RigidBodyAPI) or not UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get():
        raise stage.error("an object that cannot move", prim, fix="apply PhysicsRigidBodyAPI to it")
    mass = read_mass(stage, prim)
    frame = stage.body_frame(prim)
    colliders = read_colliders(stage, prim, frame)
    if not colliders:
        fix = "apply PhysicsCollisionAPI to a shape at it or below it"
        raise stage.error("an object without a collider", prim, allowed=ALLOWED, fix=fix)

    pose = transform(frame)
    if abs(pose[3]) > 1e-4 or abs(pose[4]) > 1e-4:
        raise stage.error("an object that does not lie flat", prim, allowed="turned about z only")
    rest_height = round(-float(height_range(colliders)[0]), 6)
    above = float(pose[2]) - rest_height
    if abs(above) > FLOATING:
        where = f"{above * 1000:.1f} mm above" if above > 0 else f"{-above * 1000:.1f} mm inside"
        fix = f"set its z to {rest_height:.4g} m"
        raise stage.error(f"an object {where} the table", prim, allowed="on it", fix=fix)

    given = UsdPhysics.MassAPI(prim).GetCenterOfMassAttr().Get()
    center = np.array([single(c) for c in given or [math.nan]])
    if not np.isfinite(center).all():
        parts = [volume_and_center(stage, collider) for collider in colliders]
        center = np.average([c for _, c in parts], axis=0, weights=[volume for volume, _ in parts])

    own = _friction(stage, prim)
    tool = stage.stage.GetPrimAtPath(tool_path).GetParent()
    pushed = PushedObject(
        path=str(prim.GetPath()),
        mass=mass,
        friction=_pair(stage, prim, own, _friction(stage, stage.role("OimppiTableAPI")[0])),
        tool_friction=_pair(stage, prim, own, _friction(stage, tool)),
        center_of_mass=center,
        colliders=colliders,
        rest_height=rest_height,
    )
    yaw = 2.0 * math.atan2(pose[5], pose[6])
    return pushed, (float(pose[0]), float(pose[1]), math.remainder(yaw, 2.0 * math.pi))


def _friction(stage: SceneStage, prim: Usd.Prim) -> float:
    """Largest friction of the materials of a prim's colliders; zero without one."""
    return max((stage.friction(shape) or 0.0 for shape in collider_prims(prim)), default=0.0)


def _pair(stage: SceneStage, prim: Usd.Prim, a: float, b: float) -> float:
    if max(a, b) <= 0.0:
        fix = "bind a material with PhysicsMaterialAPI and a physics:dynamicFriction to its colliders"
        raise stage.error("an object without friction", prim, allowed="a coefficient above zero", fix=fix)
    return max(a, b)


def _read_obstacle(stage: SceneStage, prim: Usd.Prim) -> Obstacle:
    _check_static(stage, prim, "obstacle")
    colliders = read_colliders(stage, prim, _WORLD)
    if not colliders:
        raise stage.error("an obstacle without a collider", prim, allowed=ALLOWED)
    return Obstacle(str(prim.GetPath()), colliders)


def _check_static(stage: SceneStage, prim: Usd.Prim, noun: str) -> None:
    for part in stage.prims(prim):
        if part.HasAPI(UsdPhysics.RigidBodyAPI):
            raise stage.error(
                f"a rigid body in the {noun}", part, allowed="static shapes: CollisionAPI without RigidBodyAPI"
            )


def _check_roles(stage: SceneStage, known: list[str]) -> None:
    """Nothing that the planner does not know of may collide or move."""
    paths = [Sdf.Path(path) for path in known]
    for prim in stage.prims():
        if any(prim.GetPath().HasPrefix(path) for path in paths):
            continue
        if prim.HasAPI(UsdPhysics.CollisionAPI) or prim.HasAPI(UsdPhysics.RigidBodyAPI):
            raise stage.error(
                "something that collides or moves, but has no role in the task",
                prim,
                allowed="robot, object, obstacle or table",
                fix="apply OimppiObstacleAPI to it, or remove its physics",
            )
