"""A task as data (the object, its start and goal, and the obstacles), and its conversion to USD."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdShade

from oimppi_warp.authoring.objects.flat_object import Pushable
from oimppi_warp.authoring.objects.outlines import TABLE_FRICTION
from oimppi_warp.authoring.objects.stored import is_object_file
from oimppi_warp.authoring.prims import (
    Color,
    Look,
    about_z,
    apply_api,
    attribute,
    bind_physics,
    box,
    cylinder,
    new_stage,
    physics_material,
    rounded,
    set_planar_pose,
)
from oimppi_warp.authoring.robots.posed import pose_robot
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.feasibility import check_task, sample_start
from oimppi_warp.scene import Scene
from oimppi_warp.usd import load_scene
from oimppi_warp.usd.colliders import collider_prims

Pose = tuple[float, float, float]

TABLE_LOWER, TABLE_UPPER, TABLE_THICKNESS = (-0.25, -0.8), (1.0, 0.8), 0.04
OBSTACLE_FRICTION = 0.3
TABLE_COLOR, OBSTACLE_COLOR = (0.6, 0.58, 0.54), (0.35, 0.37, 0.4)

CAMERA = (1.55, -0.95, 1.05), (0.32, -0.02, 0.1)  # m
SPREAD = (0.11, 0.45)  # half widths of the range that starts are drawn from: m, rad
PAPER, TIGHT = (0.2, 0.5), (0.05, 0.1)  # m, rad


@dataclass(frozen=True)
class Block:
    """A static box standing on the table: centre (x, y) and side lengths (x, y, z) [m], turned by yaw [rad]."""

    name: str
    center: tuple[float, float]
    size: tuple[float, float, float]
    color: Color = OBSTACLE_COLOR
    yaw: float = 0.0


@dataclass(frozen=True)
class Pillar:
    """A static upright cylinder standing on the table: centre (x, y), radius and height [m]."""

    name: str
    center: tuple[float, float]
    radius: float
    height: float
    color: Color = OBSTACLE_COLOR


@dataclass(frozen=True)
class StaticObject:
    """An object used as a static obstacle."""

    name: str
    object: Pushable
    pose: Pose


Obstacle = Block | Pillar | StaticObject


@dataclass(frozen=True)
class TableTop:
    """The table's top: its corners with the smallest and the largest x and y [m]."""

    lower: tuple[float, float] = TABLE_LOWER
    upper: tuple[float, float] = TABLE_UPPER


@dataclass(frozen=True)
class Task:
    """A task to be written as a scene; poses are (x [m], y [m], yaw [rad]).

    Attributes:
        name: Name of the scene's file.
        title: One-line description.
        object: The object to push.
        start, goal: Start and goal pose of the object.
        obstacles: Static obstacles.
        tolerance, tight: Tolerance for success, and the tight one, reported as well: position [m] and yaw [rad].
        robot_start: Joint positions at the start [rad; m for a prismatic joint]; if empty, the robot's own.
        robot: Name of the robot's file in ``robots/``; the extension defaults to ``.usda``.
        table: The table's top.
        spread: Half-widths of the range that starts are drawn from [m, rad].
        camera: Position of the camera, and the point that it looks at [m].
    """

    name: str
    title: str
    object: Pushable
    start: Pose
    goal: Pose
    obstacles: tuple[Obstacle, ...] = ()
    tolerance: tuple[float, float] = PAPER
    tight: tuple[float, float] = TIGHT
    robot_start: tuple[float, ...] = field(default=())
    robot: str = "xarm6"
    table: TableTop = TableTop()
    spread: tuple[float, float] = SPREAD
    camera: tuple[tuple[float, float, float], tuple[float, float, float]] = CAMERA


def write(
    task: Task,
    folder: Path,
    *,
    note: str = "",
    robots: str = "./robots",
    find_arm_start: Callable[[Scene], Sequence[float] | None] | None = None,
) -> Path:
    """Writes a task's scene to ``folder``, which must already contain ``objects``.

    Args:
        task: The task.
        folder: Destination.
        note: Text appended to the title in the file's documentation.
        robots: Folder of the robots, relative to ``folder``.
        find_arm_start: Gives the arm's joint positions at the start [rad], or ``None`` for the robot's own, once the
            scene is complete.

    Raises:
        SceneError: The task is not feasible (:func:`oimppi_warp.geometry.feasibility.check_task`).
    """
    file = folder / f"{task.name}.usda"
    stage = new_stage(file, "World", ". ".join(filter(None, (task.title, note))))
    world = stage.GetDefaultPrim()
    Usd.ModelAPI(world).SetKind("assembly")
    apply_api(world, "OimppiTaskAPI")
    types = Sdf.ValueTypeNames
    attribute(world, "oimppi:title", types.String, task.title)
    attribute(world, "oimppi:goal", types.Double3, Gf.Vec3d(*rounded(task.goal)))
    attribute(world, "oimppi:spread", types.Double2, Gf.Vec2d(*task.spread))
    attribute(world, "oimppi:tolerance", types.Double2, Gf.Vec2d(*task.tolerance))
    attribute(world, "oimppi:tightTolerance", types.Double2, Gf.Vec2d(*task.tight))

    gravity = UsdPhysics.Scene.Define(stage, "/World/PhysicsScene")
    gravity.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
    gravity.CreateGravityMagnitudeAttr(9.81)
    _write_view(stage, *task.camera)

    robot = stage.DefinePrim("/World/Robot")
    robot_file = task.robot if is_object_file(Path(task.robot)) else f"{task.robot}.usda"
    robot.GetReferences().AddReference(f"{robots}/{robot_file}")
    if task.robot_start:
        pose_robot(stage, "/World/Robot", task.robot_start)

    own = task.object.friction
    _write_table(stage, task.table, min(TABLE_FRICTION, own) if own else TABLE_FRICTION)
    body = stage.DefinePrim("/World/Object")
    body.GetReferences().AddReference(f"./objects/{task.object.name}.usda")
    UsdPhysics.RigidBodyAPI.Apply(body)
    apply_api(body, "OimppiObjectAPI")
    set_planar_pose(body, task.start, task.object.rest_height)

    material = physics_material(stage, "/World/Materials/Obstacle", OBSTACLE_FRICTION)
    for obstacle in task.obstacles:
        _write_obstacle(stage, obstacle, material)

    ghost = UsdGeom.Xform.Define(stage, "/World/Goal").GetPrim()
    set_planar_pose(ghost, task.goal, task.object.rest_height)
    task.object.draw(stage, "/World/Goal", Look(task.object.color, opacity=0.25))
    stage.Save()

    joints = find_arm_start(load_scene(file)) if find_arm_start is not None else None
    if joints is not None:
        pose_robot(stage, "/World/Robot", joints)
        stage.Save()
    add_starts(stage, file)
    return file


def add_starts(stage: Usd.Stage, file: Path) -> None:
    """Writes ``oimppi:starts`` (the start, and nine others drawn around it) and ``oimppi:spread`` to a scene.

    The spread is reduced where there is too little room, and only the start is written where there is none. Seeds 1001
    to 1009 are used, so that ``oimppi run --seed N`` with N up to 1000 draws different starts.

    Args:
        stage: The scene, which is saved.
        file: Its file.

    Raises:
        SceneError: The task is not feasible from its own start.
    """
    scene = load_scene(file)
    check_task(scene)
    widest = scene.spread if any(scene.spread) else SPREAD
    for share in (1.0, 0.5, 0.25, 0.125, 0.0):
        spread = (share * widest[0], share * widest[1])
        tried = replace(scene, spread=spread)
        drawn: list[Pose] = []
        if share:
            with suppress(SceneError):  # no room to draw from: try the next, smaller share
                drawn = [sample_start(tried, seed) for seed in range(1001, 1010)]
        if drawn or not share:
            break
    world = stage.GetDefaultPrim()
    world.GetAttribute("oimppi:spread").Set(Gf.Vec2d(*spread))
    starts = [Gf.Vec3d(*rounded(start)) for start in (scene.start, *drawn)]
    attribute(world, "oimppi:starts", Sdf.ValueTypeNames.Double3Array, starts)
    stage.Save()


def _write_table(stage: Usd.Stage, top: TableTop, friction: float) -> None:
    """Writes the table; its friction is at most the object's, since the larger of the two applies."""
    UsdGeom.Scope.Define(stage, "/World/Materials")
    (x0, y0), (x1, y1) = top.lower, top.upper
    center, size = ((x0 + x1) / 2, (y0 + y1) / 2, -TABLE_THICKNESS / 2), (x1 - x0, y1 - y0, TABLE_THICKNESS)
    table = box(stage, "/World/Table", center, size, Look(TABLE_COLOR, collide=True))
    apply_api(table, "OimppiTableAPI")
    bind_physics(table, physics_material(stage, "/World/Materials/Table", friction))
    if not any(collider_prims(stage.GetPrimAtPath("/World/Robot/base"))):
        return
    # The arm is bolted to the table: the lowest capsule of its base reaches into the plate.
    UsdPhysics.FilteredPairsAPI.Apply(table).CreateFilteredPairsRel().SetTargets(["/World/Robot/base"])


def _write_obstacle(stage: Usd.Stage, obstacle: Obstacle, material: UsdShade.Material) -> None:
    UsdGeom.Scope.Define(stage, "/World/Obstacles")
    path = f"/World/Obstacles/{obstacle.name}"
    if isinstance(obstacle, Block):
        center = (*obstacle.center, obstacle.size[2] / 2)
        prim = box(stage, path, center, obstacle.size, Look(obstacle.color, collide=True), about_z(obstacle.yaw))
        bind_physics(prim, material)
    elif isinstance(obstacle, Pillar):
        center = (*obstacle.center, obstacle.height / 2)
        prim = cylinder(stage, path, center, obstacle.radius, obstacle.height, Look(obstacle.color, collide=True))
        bind_physics(prim, material)
    else:
        prim = stage.DefinePrim(path)
        prim.GetReferences().AddReference(f"./objects/{obstacle.object.name}.usda")
        set_planar_pose(prim, obstacle.pose, obstacle.object.rest_height)
    apply_api(prim, "OimppiObstacleAPI")


def _write_view(stage: Usd.Stage, eye: Pose, target: Pose) -> None:
    """Writes a light, and a camera at one point that looks at another [m]."""
    UsdLux.DomeLight.Define(stage, "/World/Sky").CreateIntensityAttr(300.0)
    sun = UsdLux.DistantLight.Define(stage, "/World/Sun")
    sun.CreateIntensityAttr(1500.0)
    sun.CreateAngleAttr(2.0)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(35.0, 25.0, 0.0))
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(24.0)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 100.0))
    view = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*eye), Gf.Vec3d(*target), Gf.Vec3d(0, 0, 1))
    pose = view.GetInverse()
    camera.AddTranslateOp().Set(Gf.Vec3d(*rounded(pose.ExtractTranslation())))
    q = pose.ExtractRotationQuat()
    camera.AddOrientOp().Set(Gf.Quatf(*rounded((q.GetReal(), *q.GetImaginary()), 6)))
