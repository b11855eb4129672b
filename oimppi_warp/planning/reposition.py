"""Repositioning of the tool: an object that makes no headway is pushed from another side. Not in the paper.

The robot level looks about a second ahead, so it pushes from the tool's position, or from around the next corner. An
object wedged between an obstacle and the tool may have to be pushed from its other side, two seconds away. The planner
therefore monitors the object's headway. When there is none, it chooses the point of the outline where a push comes
closest to the motion of the reference, and leads the tip there along waypoints: over the object, or around it if the
robot cannot lift its tool.

Before that, the reference slows down. It moves faster than a wedged object can, and a reference that is far ahead cuts
corners: it asks for a push around the corner, where the object first has to be turned, or pushed aside.
"""

from __future__ import annotations

import math

import numpy as np
import shapely

from oimppi_warp.config.settings import Reposition
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import footprint, outline, planar_points, wrap_angle
from oimppi_warp.geometry.reach import can_lift, highest_tip, reach_of
from oimppi_warp.planning.stance import Outline, yaw_length_of
from oimppi_warp.scene import Scene

NO_WAYPOINT = np.zeros(4)
"""No waypoint: its weight is zero."""

_GAP = 0.012
"""Gap between the tool and the outline at the position from which it pushes [m]."""
_CLEAR = 0.03
"""Gap between the tool and the outline at which the tip may rise, and that it keeps on its path around [m]."""
_STRIDE = 0.06
"""Distance between waypoints around the object [m]."""
_ABOVE = 0.035
"""Height of the tip above the object's top while it crosses it [m]."""
_REACHED = 0.02
"""Distance at which a waypoint is reached [m]."""
_SAME_SIDE = 0.06
"""Tool positions closer together than this count as the same side of the object [m]."""
_AHEAD = 15
"""Steps along the reference that give the desired motion."""
_MARGIN = 0.004
"""Gap between the tool and an obstacle below which a position is blocked [m]."""
_ROOM = 0.01
"""Distance to the edge of the tip's reach below which a position is blocked [m]."""
_BLOCKED = 10.0
"""Subtracted from the score of a blocked side, which puts it below every other; scores are cosines."""
_SHARE = 0.1
"""Share of the remaining distance that is headway where it is less than the setting."""
_PATIENCE = 1.0
"""Time without headway after which the reference slows down [s]."""
_RECOVERY = 2.0
"""Factor by which headway speeds the reference up again."""
_REMEMBERED = 8
"""Number of tried sides at which all but the latest two are forgotten, so that they may be tried again."""


class Repositioner:
    """Monitors the object's progress; without it, slows the reference, and leads the tip to another side of the object.

    Args:
        scene: The task.
        geometry: Limit surface and distance fields of the scene.
        settings: Settings that determine when to reposition, and for how long.
        w_theta: Square of the length that a radian of yaw counts as [m^2/rad^2]; 0 if the yaw does not matter.
        height: Height of the tip while it pushes [m].
        period: Control period [s].

    Attributes:
        pace: Number of steps along the reference that should be made per control step, 1 or less.
    """

    def __init__(
        self, scene: Scene, geometry: Geometry, settings: Reposition, *, w_theta: float, height: float, period: float
    ) -> None:
        self._settings = settings
        self._turn = w_theta > 0.0
        self._period = period
        self._radius = scene.robot.tool_radius
        self._heights = (height, geometry.top + _ABOVE)
        self._lifts, self._over = can_lift(scene.robot), highest_tip(scene.robot) >= self._heights[1]
        self._reach = reach_of(scene.robot)
        self._outline = Outline(scene, geometry.surface, yaw_length=yaw_length_of(geometry.surface, w_theta))
        self._sides = self._outline.beside(self._radius + _GAP)  # tool positions, object frame
        blocks = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
        self._blocks = outline(footprint((*blocks, *scene.robot.base.colliders), lower=height, upper=geometry.top))
        self.reset()

    def reset(self) -> None:
        """Forgets the progress made, the waypoints and the sides tried before."""
        self.pace = 1.0
        self._pushed = False  # the arm is still on its way to the object
        self._least = math.inf
        self._stalled = 0.0
        self._time_left = 0.0
        self._waypoints: list[np.ndarray] = []
        self._tried: list[np.ndarray] = []

    def waypoint(self, tip: np.ndarray, pose: np.ndarray, reference: np.ndarray, to_go: float) -> np.ndarray:
        """Returns the tip's waypoint in this control step.

        Args:
            tip: Position, shape [3] [m].
            pose: Pose of the object's friction centre, shape [3].
            reference: Reference poses from now on, at full pace, shape [n, 3].
            to_go: Distance that the object still has to go [m].

        Returns:
            (x, y, z [m], weight [1/m^2]); :data:`NO_WAYPOINT` while the object makes headway.
        """
        known = all(map(math.isfinite, [to_go, *tip.tolist(), *pose.tolist()]))
        if self._settings.stall_seconds <= 0.0 or not known:
            return NO_WAYPOINT
        if self._waypoints:
            return self._next_waypoint(tip, to_go)
        if to_go < self._least - min(self._settings.headway, _SHARE * self._least):
            if math.isfinite(self._least):
                self._pushed = True
                self._tried.clear()
            self._least, self._stalled = to_go, 0.0
            self.pace = min(1.0, _RECOVERY * self.pace)
        self._stalled += self._period
        if self._pushed:
            self._slow_down()
        if self._stalled >= self._settings.stall_seconds:
            self._pushed = True
            self._choose(tip, pose, reference)
            self._least, self._stalled = to_go, 0.0
        return NO_WAYPOINT

    def _slow_down(self) -> None:
        """Lowers the pace after a time without headway, at a rate that would stop the reference at repositioning."""
        waited = (self._stalled - _PATIENCE) / max(self._settings.stall_seconds - _PATIENCE, self._period)
        self.pace = min(self.pace, max(1.0 - waited, self._settings.least_pace))

    def _next_waypoint(self, tip: np.ndarray, to_go: float) -> np.ndarray:
        """Advances to the next waypoint when one is reached; gives up on timeout."""
        self._time_left -= self._period
        if np.linalg.norm(tip - self._waypoints[0]) < _REACHED:
            self._waypoints.pop(0)
        if self._time_left <= 0.0:
            self._waypoints.clear()
        self._least, self._stalled = to_go, 0.0
        return np.append(self._waypoints[0], self._settings.w_waypoint) if self._waypoints else NO_WAYPOINT

    def _choose(self, tip: np.ndarray, pose: np.ndarray, reference: np.ndarray) -> None:
        """Chooses a side, and the waypoints that lead there."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        move = reference[min(max(round(_AHEAD * self.pace), 1), len(reference) - 1)] - pose
        wanted = np.array([c * move[0] + s * move[1], c * move[1] - s * move[0], self._turn * wrap_angle(move[2])])
        positions = planar_points(pose, self._sides)
        score = self._outline.alignment(wanted) - _BLOCKED * self._blocked(positions)
        self._tried.append(self._sides[np.argmin(np.linalg.norm(positions - tip[:2], axis=1))])
        for side in self._tried:
            score -= np.linalg.norm(self._sides - side, axis=1) < _SAME_SIDE
        best = int(np.argmax(score))
        self._tried.append(self._sides[best])
        if len(self._tried) > _REMEMBERED:
            self._tried = self._tried[-2:]

        low, high = self._heights
        target = positions[best]
        body = shapely.affinity.translate(
            shapely.affinity.rotate(self._outline.shape, pose[2], origin=(0.0, 0.0), use_radians=True), pose[0], pose[1]
        )
        straight = shapely.LineString([tip[:2], target])
        self._waypoints = [np.array([*target, low])]
        if shapely.distance(straight, body) < self._radius + 0.5 * _GAP:
            if self._over:
                aside = self._clear_of(tip[:2], body)
                self._waypoints = [np.array([*aside, high]), np.array([*target, high]), *self._waypoints]
            else:
                height = low if self._lifts else tip[2]
                self._waypoints = [
                    np.array([*point, height]) for point in (*self._around(tip[:2], target, body), target)
                ]
        self._time_left = self._settings.longest_seconds

    def _clear_of(self, tip: np.ndarray, body: shapely.Geometry) -> np.ndarray:
        """Returns the nearest position, shape [2] [m], where a tip can rise; rising while pressing tips the object.

        If that is blocked, such as at the edge of reach, it is the nearest one around the object that is not.
        """
        boundary = shapely.boundary(body)
        nearest = np.array(boundary.interpolate(boundary.project(shapely.Point(tip))).coords[0])
        inside = shapely.contains_xy(body, *tip)
        outward = nearest - tip if inside else tip - nearest
        distance = float(np.linalg.norm(outward))
        shortfall = self._radius + _CLEAR + (distance if inside else -distance)
        aside = tip + max(shortfall, 0.0) * outward / max(distance, 1e-9)
        if not self._blocked(aside[None])[0]:
            return aside
        ring = shapely.boundary(shapely.buffer(body, self._radius + _CLEAR))
        places = shapely.get_coordinates(shapely.segmentize(ring, 0.5 * _STRIDE))
        free = places[~self._blocked(places)]
        return aside if not len(free) else free[np.argmin(np.linalg.norm(free - tip, axis=1))]

    def _around(self, tip: np.ndarray, target: np.ndarray, body: shapely.Geometry) -> np.ndarray:
        """Returns the free (or else the shorter) path around the object, from tip to target, shape [n, 2] [m]."""
        ring = shapely.boundary(shapely.buffer(shapely.convex_hull(body), self._radius + _CLEAR))
        begin, end = (ring.project(shapely.Point(place)) for place in (tip, target))
        paths = []
        for length in ((end - begin) % ring.length, (end - begin) % ring.length - ring.length):
            along = begin + np.linspace(0.0, length, max(math.ceil(abs(length) / _STRIDE), 1) + 1)
            points = np.array([ring.interpolate(at % ring.length).coords[0] for at in along])
            paths.append((int(self._blocked(points).sum()), abs(length), points))
        return min(paths, key=lambda path: path[:2])[2]

    def _blocked(self, positions: np.ndarray) -> np.ndarray:
        """Returns whether tool positions, shape [n, 2] [m], are next to an obstacle or at the edge of reach."""
        points = shapely.points(positions)
        near = shapely.distance(points, self._blocks) < self._radius + _MARGIN if self._blocks else False
        return near | (self._reach.margin(positions) < _ROOM)
