"""Letting go of an object that no longer gets on, and taking hold of it where it can be pushed on.

A robot level that looks a second ahead pushes from where the tool is, or from around the corner. When an object is
wedged between an obstacle and the tool, the way out may begin on its other side, two seconds away. So the planner
watches whether the object gets on. When it does not, a point of its outline is chosen from which one push comes closest
to the motion that the reference asks for, and the tip is called there: over the object if need be, or around it where
the robot cannot lift its tool. Not in the paper.
"""

from __future__ import annotations

import math

import numpy as np
import shapely

from oimppi_warp.config.settings import Regrasp
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import footprint, outline, planar_points, wrap_angle
from oimppi_warp.geometry.reach import can_lift, reach_of
from oimppi_warp.scene import Scene

NOWHERE = np.zeros(4)
"""A guide that calls nowhere."""

_POINTS = 96
"""Points of the outline that are tried."""
_GAP = 0.012
"""Distance from the outline at which the tool takes its place [m]."""
_ASIDE = 0.03
"""Distance from the outline at which the tip goes up [m]."""
_STRIDE = 0.06
"""Distance of the stops on the way around the object [m]."""
_ABOVE = 0.035
"""Height of the tip above the object's top on its way over it [m]."""
_THERE = 0.02
"""Distance at which the tip has got to where it was called [m]."""
_SIDES = 0.06
"""Places of the tool that are closer together than this count as the same side of the object [m]."""
_AHEAD = 15
"""Steps along the reference at which the motion that is wanted is read."""


class Regrasping:
    """Watches an object's headway, and calls the tip to another side of it when there is none.

    Args:
        scene: The task.
        geometry: Its shapes.
        settings: When to let go.
        turn: Whether the object's yaw counts.
        height: Height of the tip while it pushes [m].
        period: Control period [s].
    """

    def __init__(
        self, scene: Scene, geometry: Geometry, settings: Regrasp, *, turn: bool, height: float, period: float
    ) -> None:
        self._settings = settings
        self._turn = turn
        self._period = period
        self._surface = geometry.surface
        self._friction = scene.object.tool_friction
        self._radius = scene.robot.tool_radius
        self._heights = (height, geometry.top + _ABOVE)
        self._lifts = can_lift(scene.robot)
        self._reach = reach_of(scene.robot)
        shape = outline(footprint(scene.object.colliders))
        self._shape = shapely.affinity.translate(shape, *(-geometry.surface.center))
        self._points, self._normals = _boundary(self._shape)
        self._sides = self._points - (self._radius + _GAP) * self._normals  # where the tool stands to push there
        blocks = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
        self._blocks = outline(footprint((*blocks, *scene.robot.base.colliders), lower=height, upper=geometry.top))
        self.reset()

    def reset(self) -> None:
        """Begins to watch anew."""
        self._least = math.inf
        self._idle = 0.0
        self._left = 0.0
        self._stops: list[np.ndarray] = []
        self._tried: list[np.ndarray] = []

    def guide(self, tip: np.ndarray, pose: np.ndarray, reference: np.ndarray, to_go: float) -> np.ndarray:
        """Where the tip is called to in this step.

        Args:
            tip: [3] [m].
            pose: The object's friction centre, [3].
            reference: Where it should be at each step from now, [n, 3].
            to_go: What it still has to go [m].

        Returns:
            (x, y, z [m], weight [1/m^2]); all zero while the object gets on.
        """
        known = math.isfinite(to_go) and np.isfinite(tip).all() and np.isfinite(pose).all()
        if self._settings.stall_seconds <= 0.0 or not known:
            return NOWHERE
        if self._stops:
            return self._next_stop(tip, to_go)
        if to_go < self._least - self._settings.headway:
            if math.isfinite(self._least):
                self._tried.clear()
            self._least, self._idle = to_go, 0.0
        self._idle += self._period
        if self._idle >= self._settings.stall_seconds:
            self._call(tip, pose, reference)
            self._least, self._idle = to_go, 0.0
        return NOWHERE

    def _next_stop(self, tip: np.ndarray, to_go: float) -> np.ndarray:
        """Goes on to the next stop when one is reached; gives up in time."""
        self._left -= self._period
        if np.linalg.norm(tip - self._stops[0]) < _THERE:
            self._stops.pop(0)
        if self._left <= 0.0:
            self._stops.clear()
        self._least, self._idle = to_go, 0.0
        return np.append(self._stops[0], self._settings.w_guide) if self._stops else NOWHERE

    def _call(self, tip: np.ndarray, pose: np.ndarray, reference: np.ndarray) -> None:
        """Chooses a side and the stops on the way there."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        move = reference[min(_AHEAD, len(reference) - 1)] - pose
        wanted = np.array([c * move[0] + s * move[1], c * move[1] - s * move[0], self._turn * wrap_angle(move[2])])
        places = planar_points(pose, self._sides)
        score = self._efficiency(wanted) - 10.0 * self._blocked(places)
        self._tried.append(self._sides[np.argmin(np.linalg.norm(places - tip[:2], axis=1))])
        for side in self._tried:
            score -= np.linalg.norm(self._sides - side, axis=1) < _SIDES
        best = int(np.argmax(score))
        self._tried.append(self._sides[best])
        if len(self._tried) > 8:
            self._tried = self._tried[-2:]

        low, high = self._heights
        to = places[best]
        body = shapely.affinity.translate(
            shapely.affinity.rotate(self._shape, pose[2], origin=(0.0, 0.0), use_radians=True), pose[0], pose[1]
        )
        straight = shapely.LineString([tip[:2], to])
        self._stops = [np.array([*to, low])]
        if shapely.distance(straight, body) < self._radius + 0.5 * _GAP:
            if self._lifts:
                aside = self._aside(tip[:2], body)
                self._stops = [np.array([*aside, high]), np.array([*to, high]), *self._stops]
            else:
                self._stops = [np.array([*stop, tip[2]]) for stop in (*self._around(tip[:2], to, body), to)]
        self._left = self._settings.longest_seconds

    def _aside(self, tip: np.ndarray, body: shapely.Geometry) -> np.ndarray:
        """Where a tip [2] does not touch the object: a tool that rises while it presses on it would tip it over."""
        rim = shapely.boundary(body)
        nearest = np.array(rim.interpolate(rim.project(shapely.Point(tip))).coords[0])
        inside = shapely.contains_xy(body, *tip)
        way = nearest - tip if inside else tip - nearest
        distance = float(np.linalg.norm(way))
        lack = self._radius + _ASIDE + (distance if inside else -distance)
        return tip + max(lack, 0.0) * way / max(distance, 1e-9)

    def _around(self, tip: np.ndarray, to: np.ndarray, body: shapely.Geometry) -> np.ndarray:
        """The free way, or else the shorter one, around the object from a tip [2] to a place [2], shape [n, 2]."""
        ring = shapely.boundary(shapely.buffer(shapely.convex_hull(body), self._radius + _ASIDE))
        begin, end = (ring.project(shapely.Point(place)) for place in (tip, to))
        ways = []
        for length in ((end - begin) % ring.length, (end - begin) % ring.length - ring.length):
            along = begin + np.linspace(0.0, length, max(math.ceil(abs(length) / _STRIDE), 1) + 1)
            points = np.array([ring.interpolate(at % ring.length).coords[0] for at in along])
            ways.append((int(self._blocked(points).sum()), abs(length), points))
        return min(ways, key=lambda way: way[:2])[2]

    def _efficiency(self, wanted: np.ndarray) -> np.ndarray:
        """How close one push from each point of the outline can come to a motion in the object's frame, shape [point].

        It is the cosine of the angle between the two twists, turning counted by the limit surface's radius, for the
        best force in the friction cone (equation 5: a wrench w moves the object with D w).
        """
        c = self._surface.radius
        twist = wanted * [1.0, 1.0, c]
        twist = twist / max(float(np.linalg.norm(twist)), 1e-9)
        tangents = np.column_stack([-self._normals[:, 1], self._normals[:, 0]])
        best = np.full(len(self._points), -1.0)
        for share in np.linspace(-self._friction, self._friction, 5):
            force = self._normals + share * tangents
            torque = (self._points[:, 0] * force[:, 1] - self._points[:, 1] * force[:, 0]) / c
            wrench = np.column_stack([force, torque])
            best = np.maximum(best, wrench @ twist / np.linalg.norm(wrench, axis=1))
        return best

    def _blocked(self, places: np.ndarray) -> np.ndarray:
        """Whether the tool cannot stand at places [n, 2]."""
        points = shapely.points(places)
        near = shapely.distance(points, self._blocks) < self._radius + 0.004 if self._blocks else False
        return near | (self._reach.margin(places) < 0.01)


def _boundary(shape: shapely.Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Points on an outline, evenly spread, and the normals into it, each of shape [n, 2]."""
    rings = [part.exterior for part in shapely.get_parts(shape)]
    length = sum(ring.length for ring in rings)
    points, normals = [], []
    for ring in rings:
        count = max(round(_POINTS * ring.length / length), 3)
        for at in (np.arange(count) + 0.5) * ring.length / count:
            before, after = (np.array(ring.interpolate((at + d) % ring.length).coords[0]) for d in (-1e-4, 1e-4))
            along = (after - before) / max(float(np.linalg.norm(after - before)), 1e-12)
            normal = np.array([-along[1], along[0]])
            point = 0.5 * (before + after)
            inside = shapely.contains_xy(shape, *(point + 1e-3 * normal))
            points.append(point)
            normals.append(normal if inside else -normal)
    return np.array(points), np.array(normals)
