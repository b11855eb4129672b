"""Draws pictures with one of Newton's viewers: in the browser, into a recording or into a USD file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
import warp as wp

from oimppi_warp.compute.loading import quick_compilation
from oimppi_warp.geometry.feasibility import object_outline
from oimppi_warp.geometry.footprint import footprint, height_range, outline
from oimppi_warp.observation import planar_pose
from oimppi_warp.scene import Scene
from oimppi_warp.view.picture import Picture
from oimppi_warp.view.posed_scene import PosedScene

if TYPE_CHECKING:
    from newton.viewer import ViewerBase

GOAL = (0.13, 0.62, 0.34)
TIGHT = (0.55, 0.83, 0.62)
REFERENCE = (0.95, 0.6, 0.1)
PLAN = (0.1, 0.35, 0.9)
FORCE = (0.85, 0.1, 0.1)
CLEARANCE = (0.55, 0.2, 0.6)
KEPT_APART = (1.0, 0.25, 0.0)
FAINT, STRONG = np.array((0.72, 0.76, 0.85)), np.array((0.45, 0.2, 0.75))
"""Colours of sampled paths with zero weight and with the largest weight."""
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
_NO_LENGTH = 1e-5
"""Length given to zero-length segments, since viewers divide by it [m]."""
_LIFT = 0.003
"""Height above the table of lines drawn on it [m]."""


class Canvas:
    """Draws pictures, and reloads the model when the scene's content changes.

    Args:
        viewer: One of Newton's viewers.
        thickness: Factor from the line widths in this module to the viewer's unit.

    Attributes:
        viewer: As above.
    """

    def __init__(self, viewer: ViewerBase, *, thickness: float = 1.0) -> None:
        self.viewer: Any = viewer
        self._thickness = thickness
        self._scene: Scene | None = None

    def show(self, picture: Picture) -> None:
        """Draws one picture as a frame of its own."""
        self.viewer.begin_frame(picture.time)
        self.draw(picture)
        self.viewer.end_frame()

    def draw(self, picture: Picture) -> None:
        """Draws one picture; call it between the viewer's ``begin_frame`` and ``end_frame``."""
        if self._scene is None or _model_content(self._scene) != _model_content(picture.scene):
            self._load(picture)
        self._posed.pose(picture.joints, picture.object_transform)
        self.viewer.log_state(self._posed.state)
        self._scene = picture.scene
        self._draw_goal(picture.scene)
        self._draw_plan(picture)
        self._draw_contacts(picture.contact_points)
        self._draw_clearance(picture)
        self._draw_kept_apart(picture.kept_apart)

    def _load(self, picture: Picture) -> None:
        scene = picture.scene
        with quick_compilation():  # of Newton's kernels; a planner compiles some of them like this, too
            self._posed = PosedScene(scene)
            self.viewer.set_model(self._posed.model)
            self._posed.pose(picture.joints, picture.object_transform)
            self.viewer.log_state(self._posed.state)
        with quick_compilation():  # the second call needs a kernel whose module the first call imports
            self.viewer.log_state(self._posed.state)
        shape = outline(footprint(scene.object.colliders))
        self._rings = [np.array(ring.coords) for polygon in shapely.get_parts(shape) for ring in _rings(polygon)]
        low, high = height_range(scene.object.colliders)
        self._heights = (scene.object.rest_height + low + _LIFT, scene.object.rest_height + high)
        fixed = [scene.robot.base, *scene.obstacles]
        lower, upper = self._heights
        self._obstacle_area = shapely.union_all(
            [outline(footprint(it.colliders, lower=lower, upper=upper)) for it in fixed]
        )

    def _draw_goal(self, scene: Scene) -> None:
        goal = np.array(scene.goal)
        self._lines("goal", [self._ghost(goal)], GOAL, width=0.025)
        for name, tolerance, color in (("tolerance", scene.tolerance, GOAL), ("tight", scene.tight_tolerance, TIGHT)):
            turn = np.linspace(0.0, 2 * np.pi, 49)
            ring = goal[:2] + tolerance.position * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            self._lines(name, [_segments(_raised(ring, _LIFT))], color, width=0.012)

    def _draw_plan(self, picture: Picture) -> None:
        reference = picture.reference
        if not len(reference):
            reference = planar_pose(picture.object_transform)[None]
        line = reference[np.linspace(0, len(reference) - 1, _REFERENCE_POINTS).round().astype(int)]
        self._lines("reference/way", [_segments(_raised(line[:, :2], self._heights[1] + _LIFT))], REFERENCE, width=0.02)
        self._lines("reference/ghost", [self._ghost(line[-1])], REFERENCE, width=0.01)
        if picture.sampled.size:
            shade = np.clip(picture.weights, 0.0, 1.0)[:, None] ** 0.5
            colors = (1.0 - shade) * FAINT + shade * STRONG
            steps = picture.sampled.shape[1] - 1
            paths = [_segments(path) for path in picture.sampled]
            self._lines("plan/samples", paths, np.repeat(colors, steps, axis=0), width=0.01)
            self._lines("plan/best", [_segments(picture.sampled[0])], tuple(STRONG), width=0.03)
        if len(picture.tips):
            self._lines("plan/nominal", [_segments(picture.tips)], PLAN, width=0.03)

    def _draw_contacts(self, contact_points: np.ndarray) -> None:
        largest = contact_points[np.argsort(-np.linalg.norm(contact_points[:, 3:], axis=1))[:_MAX_CONTACTS]]
        shown = np.zeros((_MAX_CONTACTS, 6))
        shown[:, 2] = -1.0  # unused entries are hidden below the table
        shown[: len(largest)] = largest
        ends = shown[:, :3] + METRES_PER_NEWTON * shown[:, 3:]
        self._lines("contact/force", [np.stack([shown[:, :3], ends], axis=1)], FORCE, width=0.04)
        points = wp.array(shown[:, :3].astype(np.float32), dtype=wp.vec3, device="cpu")
        radii = wp.full(_MAX_CONTACTS, _CONTACT_RADIUS, dtype=float, device="cpu")
        colors = wp.full(_MAX_CONTACTS, wp.vec3(*FORCE), dtype=wp.vec3, device="cpu")
        self.viewer.log_points("/oimppi/contact/point", points, radii, colors)

    def _draw_kept_apart(self, nearest: np.ndarray) -> None:
        shown = np.zeros((_MAX_CONTACTS, 2, 3))
        shown[:, :, 2] = -1.0  # unused entries are hidden below the table
        shown[: len(nearest)] = nearest[:_MAX_CONTACTS]
        self._lines("kept_apart", [shown], KEPT_APART, width=0.06)

    def _draw_clearance(self, picture: Picture) -> None:
        """Draws a line from the object to the nearest obstacle or the robot's base; hidden if none is near."""
        x, y, yaw = (float(value) for value in planar_pose(picture.object_transform))
        ends = shapely.shortest_line(object_outline(picture.scene, (x, y, yaw)), self._obstacle_area)
        near = 0.0 < shapely.length(ends) < _NEAR
        at = shapely.get_coordinates(ends) if near else np.zeros((2, 2))
        height = self._heights[1] + _LIFT if near else -1.0
        self._lines("clearance", [_segments(_raised(at, height))], CLEARANCE, width=0.03)

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
        segments = np.concatenate(parts).astype(np.float32)
        segments[np.all(segments[:, 0] == segments[:, 1], axis=1), 1, 2] += _NO_LENGTH
        colors = np.broadcast_to(np.asarray(color, np.float32), (len(segments), 3))
        starts, ends, colors = (
            wp.array(values, dtype=wp.vec3, device="cpu") for values in (segments[:, 0], segments[:, 1], colors)
        )
        self.viewer.log_lines(f"/oimppi/{name}", starts, ends, colors, width=width * self._thickness)


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
