"""Finds whether a free path leads from an object's start to its goal, and where the widest path is narrowest.

A path is free where phi_2 is above zero and the arm reaches the object's centre. The widest path is the one with the
greatest minimum clearance: the largest threshold of phi_2 at which start and goal are still connected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from oimppi_warp.geometry.feasibility import fixed_outlines, object_outline
from oimppi_warp.geometry.fields import Geometry, exact_nodes, from_center, to_center
from oimppi_warp.geometry.reach import reach_of
from oimppi_warp.scene import PlanarPose, Scene

RESOLUTION = 1e-4
"""Accuracy to which the minimum clearance of the widest path is determined [m]."""

NEIGHBOR_RANGE = 0.01
"""Things farther from the object than the nearest one by more than this do not count as its neighbours [m]."""

Node = tuple[int, int, int]


@dataclass(frozen=True)
class Bottleneck:
    """The narrowest point of the widest path to the goal.

    Attributes:
        clearance: Clearance of the object at this point [m]; negative if the object does not fit.
        pose: Planar pose of the object at this point [m, m, rad].
        neighbors: Names of the one or two bodies nearest to the object at this point.
        gap: Distance between the two bodies [m]; ``None`` if there is only one.
    """

    clearance: float
    pose: PlanarPose
    neighbors: tuple[str, ...]
    gap: float | None


class FreePaths:
    """Searches paths to a scene's goal on the grid of phi_2.

    Args:
        scene: The task; at its start and its goal, the object must overlap nothing.
        geometry: Distance fields of the task.
    """

    def __init__(self, scene: Scene, geometry: Geometry) -> None:
        self._scene, self._surface = scene, geometry.surface
        field = geometry.clearance
        values = exact_nodes(scene).astype(float)
        self._origin = np.array([0.0, *field.origin])
        self._step = 1.0 / np.array([field.inv_yaw_step, field.inv_step, field.inv_step])
        x, y = (self._origin[i] + self._step[i] * np.arange(values.shape[i]) for i in (1, 2))
        at = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        within = reach_of(scene.robot).margin(at.reshape(-1, 2)).reshape(at.shape[:2]) >= 0.0
        self._values = np.where(within, values, -np.inf)
        self._free = _components(self._values > 0.0)
        self._goals = self._nodes(scene.goal)
        if np.isinf(scene.tolerance.yaw):
            self._goals = [(turn, i, j) for _, i, j in self._goals for turn in range(len(values))]

    def clearance_near(self, pose: PlanarPose) -> float:
        """Returns the largest clearance among the grid nodes around a pose [m]."""
        return max(float(self._values[node]) for node in self._nodes(pose))

    def is_blocked(self, start: PlanarPose) -> bool:
        """Returns whether every path from a start is blocked."""
        return not self._connected(self._free, self._nodes(start))

    def bottleneck(self, start: PlanarPose) -> Bottleneck | None:
        """Returns the bottleneck of the widest path from a start, or ``None`` if it is at one of the path's ends."""
        starts = self._nodes(start)
        end = float(min(max(self._values[node] for node in nodes) for nodes in (starts, self._goals)))
        if not self._connected(_components(np.isfinite(self._values)), starts):
            return None
        if self._connected(_components(self._values >= end), starts):
            return None
        lower, upper = float(self._values[np.isfinite(self._values)].min()), end
        while upper - lower > RESOLUTION:
            middle = 0.5 * (lower + upper)
            if self._connected(_components(self._values >= middle), starts):
                lower = middle
            else:
                upper = middle
        path = self._path(lower, starts)
        values = self._values[tuple(path.T)]
        pose = self._origin + self._step * path[values.argmin()]
        x, y, yaw = map(float, from_center(self._surface, pose[[1, 2, 0]]))
        return Bottleneck(float(values.min()), (x, y, yaw), *self.neighbors((x, y, yaw)))

    def _nodes(self, pose: PlanarPose) -> list[Node]:
        """Returns the eight grid nodes around a pose of the object's frame."""
        x, y, yaw = to_center(self._surface, np.array(pose))
        turns, *size = self._values.shape
        first = np.floor((np.array([yaw % (2.0 * np.pi), x, y]) - self._origin) / self._step).astype(int)
        corners = first + np.array(list(np.ndindex(2, 2, 2)))
        corners[:, 1:] = np.clip(corners[:, 1:], 0, np.array(size) - 1)
        return [(int(k % turns), int(i), int(j)) for k, i, j in corners]

    def _connected(self, parts: np.ndarray, starts: Sequence[Node]) -> bool:
        return bool(({parts[node] for node in starts} & {parts[node] for node in self._goals}) - {0})

    def _path(self, threshold: float, starts: Sequence[Node]) -> np.ndarray:
        """Returns the nodes of a path that keeps at least this clearance, shape [n, 3]; such a path must exist."""
        free = self._values >= threshold
        parts = _components(free)
        shared = {parts[node] for node in starts} & {parts[node] for node in self._goals} - {0}
        free = parts == min(shared)
        nodes, number = np.argwhere(free), np.full(free.shape, -1)
        number[free] = np.arange(len(nodes))
        after = [np.roll(number, -1, axis=0), *(_next(number, axis) for axis in (1, 2))]
        pairs = np.concatenate([np.stack([number[free], other[free]]) for other in after], axis=1)
        pairs = pairs[:, pairs[1] >= 0]
        graph = coo_array((np.ones(pairs.shape[1], dtype=np.int8), tuple(pairs)), shape=(len(nodes),) * 2).tocsr()
        start, goal = (next(number[node] for node in ends if free[node]) for ends in (starts, self._goals))
        _, before = breadth_first_order(graph, start, directed=False)
        path = [int(goal)]
        while before[path[-1]] >= 0:
            path.append(int(before[path[-1]]))
        return nodes[path]

    def neighbors(self, pose: PlanarPose) -> tuple[tuple[str, ...], float | None]:
        """Returns the names of the one or two things nearest to the object at a pose, and their distance apart [m]."""
        shape = object_outline(self._scene, pose)
        table = shapely.box(*self._scene.table.lower, *self._scene.table.upper)
        outlines = [(f"{noun} <{path}>", outline) for noun, path, outline in fixed_outlines(self._scene)]
        outlines.append(("the table's edge", table.exterior))

        def distance(entry: tuple[str, shapely.Geometry]) -> tuple[float, float]:
            return shapely.distance(shape, entry[1]), -shapely.area(shapely.intersection(shape, entry[1]))

        first, *others = sorted(outlines, key=distance)
        near = [entry for entry in others if distance(entry)[0] <= distance(first)[0] + NEIGHBOR_RANGE][:1]
        gap = shapely.distance(first[1], near[0][1]) if near else None
        return tuple(name for name, _ in (first, *near)), gap


def _next(number: np.ndarray, axis: int) -> np.ndarray:
    """Returns the numbers of the next nodes along a non-periodic axis; -1 where there is none."""
    shifted = np.roll(number, -1, axis=axis)
    shifted[tuple(-1 if i == axis else slice(None) for i in range(number.ndim))] = -1
    return shifted


def _components(free: np.ndarray) -> np.ndarray:
    """Labels connected components from one, with zero for nodes that are not free; yaw, the first axis, is periodic."""
    parts, count = ndimage.label(free)
    seam = (parts[0] > 0) & (parts[-1] > 0)
    pairs = parts[0][seam], parts[-1][seam]
    links = coo_array((np.ones(len(pairs[0]), dtype=np.int8), pairs), shape=(count + 1, count + 1))
    _, joined = connected_components(links, directed=False)
    joined = joined + 1
    joined[0] = 0
    return joined[parts]
