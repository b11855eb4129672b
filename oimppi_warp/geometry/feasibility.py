"""Feasibility of a task: nothing overlaps at its start and its goal, and the arm reaches both."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
import shapely
from shapely import affinity

from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import footprint, height_range, outline
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.geometry.reach import can_lift, reach_of
from oimppi_warp.scene import Collider, PlanarPose, Scene

START_CLEARANCE = 0.045
"""Clearance around the object at a drawn start [m]."""

MAX_DRAWS = 2000
"""Largest number of starts drawn before giving up."""

_APPROACHES = 6
"""Number of moves that bring a drawn start to its distance from an obstacle; which point is nearest changes."""


def check_task(scene: Scene) -> None:
    """Checks that the object can be at the scene's start and goal, and that the arm reaches them.

    Raises:
        SceneError: At its start or goal the object is off the table, in an obstacle, in the robot's base or out of the
            arm's reach; or the tool touches the object or an obstacle at the start, or is too low or too high there.
    """
    for mistake in task_mistakes(scene):
        raise mistake


def task_mistakes(scene: Scene) -> Iterator[SceneError]:
    """Yields every error that :func:`check_task` may raise."""
    yield from pose_mistakes(scene, "start", scene.start)
    yield from pose_mistakes(scene, "goal", scene.goal)
    yield from _tool_mistakes(scene)


def pose_mistakes(scene: Scene, name: str, pose: PlanarPose) -> Iterator[SceneError]:
    """Yields the reasons why the object cannot be at a pose or be pushed there.

    Args:
        scene: The task.
        name: Name of the pose in messages: "start", "goal", or "start 3" for one of those listed.
        pose: Planar pose of the object: x, y, yaw [m, m, rad].
    """
    label = f"the object's {name} ({pose[0]:.3g}, {pose[1]:.3g}, {pose[2]:.3g})"
    prim = scene.object.path if name == "start" else ""
    if not np.isfinite(pose).all():
        allowed = "x [m], y [m], yaw [rad]"
        yield SceneError(f"{label} is not finite", file=scene.file, prim=prim, allowed=allowed, fix=_fix(name))
        return
    shape = object_outline(scene, pose)
    if not shapely.covers(_table(scene), shape):
        (x0, y0), (x1, y1) = scene.table.lower, scene.table.upper
        yield SceneError(
            f"{label} is not wholly on the table",
            file=scene.file,
            prim=prim,
            allowed=f"x from {x0:g} to {x1:g} m and y from {y0:g} to {y1:g} m, for the whole object",
            fix=_fix(name),
        )
    for what, path, other in fixed_outlines(scene):
        if shapely.area(shapely.intersection(shape, other)) > 1e-8:
            yield SceneError(
                f"{label} overlaps {what} <{path}>",
                file=scene.file,
                prim=prim,
                allowed="a pose at which the object overlaps nothing",
                fix=_fix(name),
            )
    yield from _reach_mistakes(scene, name, label, pose)


def sample_start(scene: Scene, seed: int) -> PlanarPose:
    """Draws a start from the scene's spread around its start; the same seed gives the same start.

    At a drawn start the object is wholly on the table, at least :data:`START_CLEARANCE` away from obstacles, the
    robot's base and the tool (if the tool is not above the object), and all of it is within the arm's reach, with room
    for the tool behind it. If both spreads are zero, as by default, nothing is drawn: the scene's own start is returned
    unchecked.

    Args:
        scene: The task.
        seed: An integer, zero or more.

    Returns:
        Planar pose of the object's frame: x, y, yaw [m, m, rad].

    Raises:
        SceneError: A spread is above zero, and none of :data:`MAX_DRAWS` draws is such a start.
    """
    position, yaw = scene.spread
    if position == 0.0 and yaw == 0.0:
        return scene.start
    random = np.random.default_rng(seed)
    fits = _roomy_starts(scene, START_CLEARANCE)
    for _ in range(MAX_DRAWS):
        pose = _rounded(np.asarray(scene.start) + random.uniform(-1.0, 1.0, 3) * (position, position, yaw))
        if fits(pose):
            return pose
    raise SceneError(
        f"none of {MAX_DRAWS} starts drawn around ({scene.start[0]:.3g}, {scene.start[1]:.3g}) is free and within "
        "reach",
        file=scene.file,
        allowed=f"{START_CLEARANCE:g} m of clearance around the object, and the whole object {_reach_text(scene)}",
        fix="give a start, or reduce oimppi:spread",
    )


def sample_beside(scene: Scene, seed: int, gap: tuple[float, float]) -> PlanarPose:
    """Draws a start beside an obstacle or the robot's base; the same seed gives the same start.

    The object is anywhere on the table, with any yaw, within the arm's reach with room for the tool behind it, and at
    least :data:`START_CLEARANCE` away from the tool.

    Args:
        scene: The task.
        seed: An integer, zero or more.
        gap: Least and largest distance to the nearest obstacle or the base [m].

    Returns:
        Planar pose of the object's frame: x, y, yaw [m, m, rad].

    Raises:
        SceneError: None of :data:`MAX_DRAWS` draws is such a start.
    """
    random = np.random.default_rng(seed)
    fixed = shapely.union_all([other for _, _, other in fixed_outlines(scene)])
    fits = _roomy_starts(scene, 0.0)
    lower, upper = np.array([*scene.table.lower, -np.pi]), np.array([*scene.table.upper, np.pi])
    for _ in range(MAX_DRAWS):
        pose, wanted = random.uniform(lower, upper), random.uniform(*gap)
        for _ in range(_APPROACHES):
            line = shapely.shortest_line(object_outline(scene, _rounded(pose)), fixed)
            if line is None or shapely.length(line) == 0.0:
                break
            if gap[0] <= shapely.length(line) <= gap[1] and fits(_rounded(pose)):
                return _rounded(pose)
            begin, end = shapely.get_coordinates(line)
            pose[:2] += (1.0 - wanted / shapely.length(line)) * (end - begin)
    raise SceneError(
        f"none of {MAX_DRAWS} starts drawn is free and {gap[0]:g} to {gap[1]:g} m from an obstacle or the base",
        file=scene.file,
        allowed=f"a table with room beside an obstacle or the base, for the whole object {_reach_text(scene)}",
        fix="leave `beside` out for this scene, or give it wider limits",
    )


def _rounded(pose: np.ndarray) -> PlanarPose:
    """Returns a pose with four digits behind the point."""
    return round(float(pose[0]), 4), round(float(pose[1]), 4), round(float(pose[2]), 4)


def _roomy_starts(scene: Scene, clearance: float) -> Callable[[PlanarPose], bool]:
    """Returns a test for starts: on the table, in reach with room for the tool behind, and free.

    Args:
        scene: The task.
        clearance: Least clearance to obstacles and the robot's base [m]; to the tool it is :data:`START_CLEARANCE`.
    """
    reach, table, tool = reach_of(scene.robot), _table(scene), _tool(scene)
    outlines = [(other, clearance) for _, _, other in fixed_outlines(scene)]
    if tool is not None:
        outlines.append((tool, START_CLEARANCE))

    def fits(pose: PlanarPose) -> bool:
        shape = object_outline(scene, pose)
        behind = reach.margin(shapely.get_coordinates(shape)).min() >= 2.0 * scene.robot.tool_radius
        free = all(shapely.distance(shape, other) >= least for other, least in outlines)
        return bool(free and behind and shapely.covers(table, shape))

    return fits


def object_outline(scene: Scene, pose: PlanarPose) -> shapely.Geometry:
    """Returns the area that the object covers at a planar pose, seen from above, in the world frame [m]."""
    shape = affinity.rotate(outline(footprint(scene.object.colliders)), pose[2], origin=(0.0, 0.0), use_radians=True)
    return affinity.translate(shape, pose[0], pose[1])


def _table(scene: Scene) -> shapely.Geometry:
    return shapely.box(*scene.table.lower, *scene.table.upper)


def _fix(name: str) -> str:
    fixes = {
        "start": "move the object in the file, or give another start",
        "goal": "change oimppi:goal, or give another goal",
    }
    return fixes.get(name, "change it in oimppi:starts, or remove it")


def _reach_mistakes(scene: Scene, name: str, label: str, pose: PlanarPose) -> Iterator[SceneError]:
    (x, y), (c, s) = scene.object.center_of_mass[:2], (np.cos(pose[2]), np.sin(pose[2]))
    center = np.array([pose[0] + c * x - s * y, pose[1] + s * x + c * y])
    reach = reach_of(scene.robot)
    margin = float(reach.margin(center[None])[0])
    if margin < 0.0:
        from_base = f"{np.hypot(*center):.2f} m from the arm's base"
        where = from_base if reach.border is None else f"{-margin:.2f} m beyond it"
        yield SceneError(
            f"{label} is out of reach: the object's centre would be {where}",
            file=scene.file,
            prim=scene.object.path if name == "start" else "",
            allowed=f"{_reach_text(scene)}, the reach of the tool when it points down",
            fix=_fix(name),
        )


def _reach_text(scene: Scene) -> str:
    """Describes the arm's reach for an error."""
    reach = reach_of(scene.robot)
    if reach.border is None:
        return f"up to {reach.radius:.2f} m from the arm's base"
    (x0, y0), (x1, y1) = reach.bounds
    return f"within x from {x0:.2f} to {x1:.2f} m and y from {y0:.2f} to {y1:.2f} m"


def fixed_outlines(scene: Scene) -> Iterable[tuple[str, str, shapely.Geometry]]:
    """Yields the robot's base and the obstacles: a noun, the prim, and the area covered at the object's height.

    The area is seen from above, in the world frame [m]; it is empty for an obstacle above the object.
    """
    low, high = (scene.object.rest_height + z for z in height_range(scene.object.colliders))

    def covered(colliders: Iterable[Collider]) -> shapely.Geometry:
        return outline(footprint(colliders, lower=low + 1e-3, upper=high))

    if scene.robot.base.colliders:
        yield "the robot's base", scene.robot.base.path, covered(scene.robot.base.colliders)
    for obstacle in scene.obstacles:
        yield "the obstacle", obstacle.path, covered(obstacle.colliders)


def _tool(scene: Scene) -> shapely.Geometry | None:
    """Returns the area that the tool covers at the start of an episode; ``None`` if it is above the object."""
    tip = tip_frame(scene.robot, scene.robot.start)[1]
    if tip[2] > scene.object.rest_height + height_range(scene.object.colliders)[1]:
        return None
    return shapely.Point(tip[:2]).buffer(scene.robot.tool_radius)


def _tool_mistakes(scene: Scene) -> Iterator[SceneError]:
    tip = tip_frame(scene.robot, scene.robot.start)[1]
    disc = shapely.Point(tip[:2]).buffer(scene.robot.tool_radius)
    outlines = []
    if _tool(scene) is not None:
        outlines.append(("the object", scene.object.path, object_outline(scene, scene.start)))
    for obstacle in scene.obstacles:
        if height_range(obstacle.colliders)[1] > tip[2]:
            outlines.append(("the obstacle", obstacle.path, outline(footprint(obstacle.colliders, lower=tip[2]))))
    for what, path, shape in outlines:
        if disc.intersects(shape):
            x, y, z = np.round(tip, 3) + 0.0  # not -0
            yield SceneError(
                f"the tool touches {what} <{path}> at the start, with its tip at ({x:.3g}, {y:.3g}, {z:.3g}) m",
                file=scene.file,
                prim=scene.robot.path,
                allowed="joint positions at which the tool touches nothing",
                fix="change oimppi:startJoints, or start the object elsewhere",
            )
    if _tool(scene) is None and not can_lift(scene.robot):
        yield SceneError(
            f"the tool passes over the object: its tip stays {tip[2]:.3f} m above the table",
            file=scene.file,
            prim=scene.robot.path,
            allowed="a tip below the object's top, for a robot that cannot lower its tool",
            fix="use a longer stick, or a taller object",
        )
    if tip[2] < 0.0:
        yield SceneError(
            f"the tool starts {-tip[2]:.3f} m below the table",
            file=scene.file,
            prim=scene.robot.path,
            allowed="a tip above z = 0",
            fix="change oimppi:startJoints",
        )
