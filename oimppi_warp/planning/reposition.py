"""Repositioning: an object that makes no headway is let go, and pushed from another place. Not in the paper.

The robot level looks about a second ahead, so it pushes from the tool's position, or from around the next corner. The
object level does not know which pushes are possible: an object may be wedged, or the arm would have to reach behind it,
close to its own base. The planner therefore monitors the object's headway. When there is none, it chooses, among the
pushes that are possible (``planning/pushes.py``), the one that leaves the least way to go. It leads the tip to where
that push begins: over the object, or around it if the robot cannot lift its tool. Then the robot level follows the push
instead of its reference.

Before that, the reference slows down. It moves faster than a wedged object can, and a reference that is far ahead cuts
corners: it asks for a push around the corner, where the object first has to be turned, or pushed aside.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely

from oimppi_warp.config.settings import Reposition
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import footprint, outline, planar_points, wrap_angle
from oimppi_warp.geometry.reach import can_lift, highest_tip, reach_of
from oimppi_warp.planning.progress import poses_at
from oimppi_warp.planning.pushes import SPACING, Push, Pushes
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
_MARGIN = 0.004
"""Gap between tool or arm and an obstacle below which a position is blocked [m]."""
_ROOM = 0.01
"""Distance to the edge of the tip's reach below which a position is blocked [m]."""
_SPEED = 0.1
"""Speed of the object along a push, a radian counted as its ``yaw_length`` [m/s]."""
_ASTRAY = 0.03
"""Distance of the object from its push at which the push is given up [m]."""
_SHARE = 0.1
"""Share of the remaining distance that is headway where it is less than the setting."""
_PATIENCE = 1.0
"""Time without headway after which the reference slows down [s]."""
_RECOVERY = 2.0
"""Factor by which headway speeds the reference up again."""
_REMEMBERED = 6
"""Number of tried places beyond which all but the latest two are forgotten, so that they may be tried again."""


class Repositioner:
    """Monitors the object's progress; without it, slows the reference, and then has the object pushed from elsewhere.

    Args:
        scene: The task.
        geometry: Limit surface and distance fields of the scene.
        settings: Settings that determine when to reposition, and for how long.
        w_theta: Square of the length that a radian of yaw counts as [m^2/rad^2]; 0 if the yaw does not matter.
        height: Height of the tip while it pushes [m].
        period: Control period [s].
        arm_clearance: Function of tip positions [n, 2] at that height that returns the clearance of arm and tool, [n]
            [m]; ``None`` if it is not known.

    Attributes:
        pace: Number of steps along the reference that should be made per control step, 1 or less.
    """

    def __init__(
        self,
        scene: Scene,
        geometry: Geometry,
        settings: Reposition,
        *,
        w_theta: float,
        height: float,
        period: float,
        arm_clearance: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self._settings = settings
        self._period = period
        self._radius = scene.robot.tool_radius
        self._heights = (height, geometry.top + _ABOVE)
        self._lifts, self._over = can_lift(scene.robot), highest_tip(scene.robot) >= self._heights[1]
        self._reach = reach_of(scene.robot)
        self._arm_clearance = arm_clearance
        self._yaw_length = yaw_length_of(geometry.surface, w_theta)
        self._outline = Outline(scene, geometry.surface, yaw_length=self._yaw_length)
        blocks = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
        self._blocks = outline(footprint((*blocks, *scene.robot.base.colliders), lower=height, upper=geometry.top))
        if arm_clearance is not None:
            arm_clearance(np.zeros((1, 2)))  # reads the field from the device now, not while the arm moves
        self._pushes = Pushes(geometry, self._outline, radius=self._radius, gap=_GAP, blocked=self._blocked)
        self.reset()

    def reset(self) -> None:
        """Forgets the progress made, the waypoints, the push and the places tried before."""
        self.pace = 1.0
        self._pushed = False  # the arm is still on its way to the object
        self._least = math.inf
        self._forgets_below = math.inf  # way to go at which places may be tried again
        self._stalled = 0.0
        self._time_left = 0.0
        self._waypoints: list[np.ndarray] = []
        self._push: Push | None = None
        self._along = 0  # index of the pose of the push that the object is nearest to
        self._tried: list[np.ndarray] = []

    def waypoint(
        self,
        tip: np.ndarray,
        pose: np.ndarray,
        to_go_from: Callable[[np.ndarray], float],
        to_goal_from: Callable[[np.ndarray], float] | None = None,
    ) -> np.ndarray:
        """Returns the tip's waypoint in this control step.

        Args:
            tip: Position, shape [3] [m].
            pose: Pose of the object's friction centre, shape [3].
            to_go_from: Function of such a pose that returns the distance that the object still has to go [m].
            to_goal_from: The same without regard to a plan that the object follows, by which pushes are chosen once one
                has brought no headway: it may be the plan that cannot be followed. ``None``: ``to_go_from``.

        Returns:
            (x, y, z [m], weight [1/m^2]); :data:`NO_WAYPOINT` while the object makes headway.
        """
        to_go = to_go_from(pose)
        known = all(map(math.isfinite, [to_go, *tip.tolist(), *pose.tolist()]))
        if self._settings.stall_seconds <= 0.0 or not known:
            return NO_WAYPOINT
        if self._waypoints:
            return self._next_waypoint(tip, to_go)
        if self._push is not None:
            self._follow(self._push, pose, to_go)
        if to_go < self._least - min(self._settings.headway, _SHARE * self._least):
            if math.isfinite(self._least):
                self._pushed = True
            if to_go < self._forgets_below:
                self._forgets_below = to_go - self._settings.headway
                self._tried.clear()
            self._least, self._stalled = to_go, 0.0
            self.pace = min(1.0, _RECOVERY * self.pace)
        self._stalled += self._period
        if self._pushed and self._push is None:
            self._slow_down()
        if self._stalled >= self._settings.stall_seconds:
            self._pushed = True
            self._choose(tip, pose, to_goal_from if self._tried and to_goal_from else to_go_from)
            self._least, self._stalled = to_go, 0.0
        return NO_WAYPOINT

    def detour(self, steps: int) -> np.ndarray | None:
        """Returns the poses of the push to follow from now on, one per control step; ``None`` if there is none.

        Args:
            steps: Number of poses.

        Returns:
            Poses of the object's friction centre, shape [steps, 3] [m, m, rad].
        """
        if self._push is None or self._waypoints:
            return None
        path = self._push.path
        at = self._along + _SPEED * self._period / SPACING * np.arange(steps)
        return poses_at(path, np.minimum(at, len(path) - 1.0))

    def _slow_down(self) -> None:
        """Lowers the pace after a time without headway, at a rate that would stop the reference at repositioning."""
        waited = (self._stalled - _PATIENCE) / max(self._settings.stall_seconds - _PATIENCE, self._period)
        self.pace = min(self.pace, max(1.0 - waited, self._settings.least_pace))

    def _next_waypoint(self, tip: np.ndarray, to_go: float) -> np.ndarray:
        """Advances to the next waypoint when one is reached, and to the push after the last; gives up on timeout."""
        self._time_left -= self._period
        if np.linalg.norm(tip - self._waypoints[0]) < _REACHED:
            self._waypoints.pop(0)
        if self._time_left <= 0.0:
            self._waypoints.clear()
            self._push = None
        elif not self._waypoints:
            self._time_left = self._settings.longest_seconds
        self._least, self._stalled = to_go, 0.0
        return np.append(self._waypoints[0], self._settings.w_waypoint) if self._waypoints else NO_WAYPOINT

    def _follow(self, push: Push, pose: np.ndarray, to_go: float) -> None:
        """Notes how far along a push the object is, which counts as headway; ends it when it is over, or on timeout."""
        self._time_left -= self._period
        away = push.path - pose
        away[:, 2] = self._yaw_length * wrap_angle(away[:, 2])
        distances = np.linalg.norm(away, axis=1)
        nearest = int(np.argmin(distances))
        if nearest > self._along:
            self._stalled = 0.0
        self._along = nearest
        if nearest == len(distances) - 1 or distances[nearest] > _ASTRAY or self._time_left <= 0.0:
            self._push = None
            self._least, self._stalled, self.pace = to_go, 0.0, 1.0

    def _choose(self, tip: np.ndarray, pose: np.ndarray, to_go_from: Callable[[np.ndarray], float]) -> None:
        """Chooses a push, and the waypoints that lead to its beginning."""
        self._push, self._along = self._pushes.best(pose, to_go_from, self._tried), 0
        if self._push is None:
            return
        self._tried.append(self._push.place)
        if len(self._tried) > _REMEMBERED:
            self._tried = self._tried[-2:]

        low, high = self._heights
        target = planar_points(pose, self._push.place)[0]
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
        """Returns whether tool or arm are next to an obstacle or at the edge of reach at tool positions [n, 2] [m]."""
        points = shapely.points(positions)
        blocked = self._reach.margin(positions) < _ROOM
        if self._blocks:
            blocked |= shapely.distance(points, self._blocks) < self._radius + _MARGIN
        if self._arm_clearance is not None:
            blocked |= self._arm_clearance(positions) < _MARGIN
        return blocked
