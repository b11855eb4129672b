"""Draws pictures on a display: in the browser, in Rerun or into a USD file."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from shapely import affinity

from oimppi_warp.geometry.footprint import footprint, height_range, outline
from oimppi_warp.observation import planar_pose
from oimppi_warp.scene import Scene
from oimppi_warp.view.display import Display
from oimppi_warp.view.picture import Picture

GOAL = (0.13, 0.62, 0.34)
TIGHT = (0.55, 0.83, 0.62)
REFERENCE = (0.95, 0.6, 0.1)
PLAN = (0.1, 0.35, 0.9)
FORCE = (0.85, 0.1, 0.1)
CLEARANCE = (0.8, 0.15, 0.4)
KEPT_APART = (1.0, 0.25, 0.0)
FAINT, STRONG = np.array((0.72, 0.76, 0.85)), np.array((0.45, 0.2, 0.75))
"""Colours of sampled paths with zero weight and with the largest weight. All colours are linear RGB, 0 to 1."""
LEGEND = (
    (GOAL, "goal, and the position tolerance around it"),
    (TIGHT, "tight position tolerance"),
    (REFERENCE, "the object's plan: path and last pose"),
    (tuple(FAINT), "sampled paths of the tool; the more weight, the more violet"),
    (tuple(STRONG), "best sample"),
    (PLAN, "planned path of the tool"),
    (FORCE, "contact points and forces"),
    (CLEARANCE, "shortest line from the object to an obstacle"),
    (KEPT_APART, "nearest points of shapes that the safety filter keeps apart"),
)
"""Colours, and what is drawn in them."""
METRES_PER_NEWTON = 0.01
"""Drawn length of a contact force per newton."""
_REFERENCE_POINTS = 60
"""Number of points drawn of a reference; constant, so that lines are updated instead of recreated."""
_MAX_CONTACTS = 8
"""Maximum number of contact forces drawn."""
_CONTACT_RADIUS = 0.006
"""Drawn radius of a contact point [m]."""
_NEAR = 0.3
"""Clearance up to which the clearance line is drawn [m]."""
_LIFT = 0.003
"""Height above the table of lines drawn on it [m]."""


class Canvas:
    """Draws pictures, and loads the scene anew when its content changes.

    Args:
        display: What is drawn on.
    """

    def __init__(self, display: Display) -> None:
        self._display = display
        self._scene: Scene | None = None

    def show(self, picture: Picture) -> None:
        """Draws one picture as a frame of its own."""
        with self._display.frame(picture.time):
            self.draw(picture)

    def draw(self, picture: Picture) -> None:
        """Draws one picture within a frame of the display.

        Raises:
            SceneError: The scene's file can no longer be read; later pictures are drawn with the old shapes.
        """
        before, self._scene = self._scene, picture.scene
        if before is None or _model_content(before) != _model_content(picture.scene):
            self._load(picture.scene)
        self._display.pose(picture.joints, picture.object_transform)
        self._draw_goal(picture.scene)
        self._draw_plan(picture)
        self._draw_contacts(picture.contact_points)
        self._draw_clearance(picture)
        self._draw_kept_apart(picture.kept_apart)

    def _load(self, scene: Scene) -> None:
        self._outline = shape = outline(footprint(scene.object.colliders))
        self._rings = [np.array(ring.coords) for polygon in shapely.get_parts(shape) for ring in _rings(polygon)]
        low, high = height_range(scene.object.colliders)
        self._heights = (scene.object.rest_height + low + _LIFT, scene.object.rest_height + high)
        fixed = [scene.robot.base, *scene.obstacles]
        lower, upper = self._heights
        self._obstacle_area = shapely.union_all(
            [outline(footprint(it.colliders, lower=lower, upper=upper)) for it in fixed]
        )
        self._target: tuple[object, ...] = ()
        self._display.load(scene)

    def _draw_goal(self, scene: Scene) -> None:
        """Draws the goal and its tolerances, with the same arrays as before if they are the same."""
        target = scene.goal, scene.tolerance, scene.tight_tolerance
        if target != self._target:
            self._target = target
            parts = {"goal": (self._ghost(np.array(scene.goal)), GOAL, 2.5)}
            turn = np.linspace(0.0, 2 * np.pi, 49)
            circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
            for name, it, color in (("tolerance", scene.tolerance, GOAL), ("tight", scene.tight_tolerance, TIGHT)):
                ring = np.array(scene.goal[:2]) + it.position * circle
                parts[name] = _segments(_raised(ring, _LIFT)), color, 1.2
            self._goal = {
                name: (part, np.tile(color, (len(part), 1)), width) for name, (part, color, width) in parts.items()
            }
        for name, (segments, colors, width) in self._goal.items():
            self._display.lines(name, segments, colors, width)

    def _draw_plan(self, picture: Picture) -> None:
        reference = picture.reference
        if not len(reference):
            reference = planar_pose(picture.object_transform)[None]
        line = reference[np.linspace(0, len(reference) - 1, _REFERENCE_POINTS).round().astype(int)]
        self._lines("reference/way", [_segments(_raised(line[:, :2], self._heights[1] + _LIFT))], REFERENCE, width=2.0)
        self._lines("reference/ghost", [self._ghost(line[-1])], REFERENCE, width=1.0)
        if picture.sampled.size:
            shade = np.clip(picture.weights, 0.0, 1.0)[:, None] ** 0.5
            colors = (1.0 - shade) * FAINT + shade * STRONG
            steps = picture.sampled.shape[1] - 1
            paths = [_segments(path) for path in picture.sampled]
            self._lines("plan/samples", paths, np.repeat(colors, steps, axis=0), width=1.0)
            self._lines("plan/best", [_segments(picture.sampled[0])], tuple(STRONG), width=3.0)
        if len(picture.tips):
            self._lines("plan/nominal", [_segments(picture.tips)], PLAN, width=3.0)

    def _draw_contacts(self, contact_points: np.ndarray) -> None:
        largest = contact_points[np.argsort(-np.linalg.norm(contact_points[:, 3:], axis=1))[:_MAX_CONTACTS]]
        shown = np.zeros((_MAX_CONTACTS, 6))
        shown[:, 2] = -1.0  # unused entries are hidden below the table
        shown[: len(largest)] = largest
        ends = shown[:, :3] + METRES_PER_NEWTON * shown[:, 3:]
        self._lines("contact/force", [np.stack([shown[:, :3], ends], axis=1)], FORCE, width=4.0)
        self._display.points("contact/point", shown[:, :3], _CONTACT_RADIUS, FORCE)

    def _draw_kept_apart(self, nearest: np.ndarray) -> None:
        shown = np.zeros((_MAX_CONTACTS, 2, 3))
        shown[:, :, 2] = -1.0  # unused entries are hidden below the table
        shown[: len(nearest)] = nearest[:_MAX_CONTACTS]
        self._lines("kept_apart", [shown], KEPT_APART, width=6.0)

    def _draw_clearance(self, picture: Picture) -> None:
        """Draws a line from the object to the nearest obstacle or the robot's base; hidden if none is near."""
        x, y, yaw = (float(value) for value in planar_pose(picture.object_transform))
        c, s = np.cos(yaw), np.sin(yaw)
        area = affinity.affine_transform(self._outline, [c, -s, s, c, x, y])
        ends = shapely.shortest_line(area, self._obstacle_area)
        near = 0.0 < shapely.length(ends) < _NEAR
        at = shapely.get_coordinates(ends) if near else np.zeros((2, 2))
        height = self._heights[1] + _LIFT if near else -1.0
        self._lines("clearance", [_segments(_raised(at, height))], CLEARANCE, width=3.0)

    def _ghost(self, pose: np.ndarray) -> np.ndarray:
        """Returns the edges of the object at a planar pose [m, m, rad], shape [n, 2, 3] [m]."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        edges = []
        for ring in self._rings:
            at = ring @ np.array([[c, s], [-s, c]]) + pose[:2]
            low, high = (_raised(at, height) for height in self._heights)
            edges += [_segments(low), _segments(high)]
            if len(ring) < 20:  # the edges of a round object would form a solid wall
                edges.append(np.stack([low, high], axis=1))
        return np.concatenate(edges)

    def _lines(self, name: str, parts: list[np.ndarray], color: Any, *, width: float) -> None:
        segments = np.concatenate(parts)
        colors = np.broadcast_to(np.asarray(color, dtype=float), (len(segments), 3))
        self._display.lines(name, segments, colors, width)


def _model_content(scene: Scene) -> tuple[object, ...]:
    """Returns the parts of a scene that determine its model; start and goal are not among them."""
    return scene.file, scene.robot, scene.object, scene.table, scene.obstacles


def _rings(polygon: Any) -> list[Any]:
    return [polygon.exterior, *polygon.interiors]


def _raised(points: np.ndarray, height: float) -> np.ndarray:
    """Lifts points, shape [n, 2], to a height; returns shape [n, 3] [m]."""
    return np.column_stack([points, np.full(len(points), height)])


def _segments(path: np.ndarray) -> np.ndarray:
    """Splits a path, shape [n, 3], into segments, shape [n - 1, 2, 3] [m]."""
    return np.stack([path[:-1], path[1:]], axis=1)
