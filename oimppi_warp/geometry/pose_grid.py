"""phi_2 on its grid: clearance of the object over planar poses, exact at the nodes or safe between them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from functools import cached_property

import numpy as np
import warp as wp

from oimppi_warp.compute.cache import cached, content_of
from oimppi_warp.compute.step import Compute
from oimppi_warp.geometry.footprint import Piece
from oimppi_warp.geometry.reach import object_bounds, stretched_length
from oimppi_warp.kernels.fields import distance as kernels
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.scene import Scene

STEP = 0.01
"""Grid step of phi_2 [m]."""
YAW_NODES = 72
"""Nodes of phi_2 over a full turn (5 degrees)."""
FURTHEST = 0.15
"""Distance at which the fields are cut off [m]."""
TIGHT = 0.03
"""Clearance, and depth of penetration, up to which phi_2 is not overestimated [m]."""
NEGLIGIBLE = 0.0001
"""Overestimate of phi_2 that is not removed: that of a corner which moves on an arc between two nodes of yaw [m]."""


class PoseGrid:
    """The grid of phi_2: values at its nodes, shape [yaw, x, y] [m], from the cache if they are stored there.

    Args:
        body, obstacles: Pieces of the object around its friction centre, and of what it may meet.
        scene: The task.
        cpu: Launches the kernels.

    Attributes:
        origin: Position of the first node, shape [2] [m].
    """

    def __init__(self, body: list[Piece], obstacles: tuple[Piece, ...], scene: Scene, cpu: Compute) -> None:
        lower, upper = np.array(scene.table.lower), np.array(scene.table.upper)
        reach = stretched_length(scene.robot)
        self.origin = np.maximum(lower, -reach)
        last = np.floor((np.minimum(upper, reach) - self.origin) / STEP + 1e-6).astype(int)
        self._shape = (YAW_NODES, *(last + 1))
        self._bounds = object_bounds(scene)
        self._body, self._obstacles = (pack_pieces(pieces, "cpu") for pieces in (body, obstacles))
        self._cpu = cpu
        shapes = [x for piece in (*body, *obstacles) for x in (piece.vertices, piece.radius)]
        self._content = [*shapes, len(body), self.origin, self._shape, STEP, FURTHEST]

    def exact(self) -> np.ndarray:
        """Returns phi_2, exact at the nodes but overestimated between them."""
        return self._with_edge(self._distance())

    @cached_property
    def obstruction(self) -> np.ndarray:
        """Returns the clearance to obstacles alone, not overestimated between the nodes."""
        content = content_of(*self._content, TIGHT, NEGLIGIBLE)
        return cached("obstruction", content, lambda: conservative(self._distance(), self._compute))

    def clearance(self) -> np.ndarray:
        """Returns phi_2, not overestimated between the nodes."""
        content = content_of(*self._content, TIGHT, NEGLIGIBLE, *self._bounds)
        return cached("phi2", content, lambda: self._with_edge(self.obstruction))

    def _distance(self) -> np.ndarray:
        """Returns the clearance to obstacles alone, exact at the nodes."""

        def compute() -> np.ndarray:
            return self._compute(np.zeros(self._shape), np.zeros(3), FURTHEST)

        return cached("distance", content_of(*self._content), compute)

    def _with_edge(self, gap: np.ndarray) -> np.ndarray:
        """Returns the smaller one of a clearance to obstacles and that to the table's edge."""
        values = wp.zeros(self._shape, dtype=float, device="cpu")
        known = wp.array(gap, dtype=float, device="cpu")
        inputs = [self._body, known, *(wp.vec2(*corner) for corner in self._bounds), self._first(np.zeros(3)), STEP]
        self._cpu.run(self._cpu.launch_samples(kernels.object_clearance, values.size, inputs, [values]))
        return values.numpy()

    def field(self, values: np.ndarray, device: str) -> PoseField:
        """Returns values at the nodes as a field on a device."""
        field = PoseField()
        field.values = wp.array(values, dtype=float, device=device)
        field.origin = wp.vec2(*self.origin)
        field.inv_step = 1.0 / STEP
        field.inv_yaw_step = YAW_NODES / (2.0 * np.pi)
        return field

    def _compute(self, estimate: np.ndarray, shift: np.ndarray, furthest: float) -> np.ndarray:
        """Computes the clearance to obstacles for :func:`conservative`."""
        values = wp.array(estimate, dtype=float, device="cpu")
        inputs = [self._body, self._obstacles, self._first(shift), STEP, furthest]
        self._cpu.run(self._cpu.launch_samples(kernels.object_obstruction, values.size, inputs, [values]))
        return values.numpy()

    def _first(self, shift: np.ndarray) -> wp.vec3:
        """Returns the pose of the first node, shifted by fractions of a step (yaw, x, y)."""
        yaw, x, y = shift * (2.0 * np.pi / YAW_NODES, STEP, STEP)
        return wp.vec3(self.origin[0] + x, self.origin[1] + y, yaw)


def conservative(values: np.ndarray, clearance: Callable[[np.ndarray, np.ndarray, float], np.ndarray]) -> np.ndarray:
    """Returns the nodes of a clearance, lowered so that interpolation does not overestimate it, shape [yaw, x, y] [m].

    Around a corner the clearance is convex over the poses, and interpolation overestimates it, by up to 4 mm on this
    grid. The overestimate is computed half-way between nodes: along the edges of the cells first, then on their faces,
    then at their centres. All nodes that an interpolation uses are lowered by its overestimate, except for a negligible
    part.

    Args:
        values: Clearance at the nodes, shape [yaw, x, y] [m].
        clearance: Computes the clearance on a grid that is shifted by fractions of a step (yaw, x, y), at the nodes
            where an estimate is smaller than a limit, positive or negative; elsewhere it returns the estimate.
    """
    values = values.copy()
    for toward in sorted(itertools.product((0, 1), repeat=3), key=sum)[1:]:
        axes = np.flatnonzero(toward)
        between = values
        for axis in axes:
            between = 0.5 * (between + np.roll(between, -1, axis))
        excess = np.maximum(between - clearance(between, 0.5 * np.array(toward), TIGHT) - NEGLIGIBLE, 0.0)
        for axis in axes:
            if axis > 0:  # the yaw is periodic; x and y are not
                excess[(slice(None),) * axis + (-1,)] = 0.0
            excess = np.maximum(excess, np.roll(excess, 1, axis))
        values -= excess
    return values


def pack_pieces(pieces: Iterable[Piece], device: str) -> kernels.Pieces:
    """Packs convex pieces for the kernels, as arrays on a device."""
    pieces = list(pieces)
    centers = np.array([piece.vertices.mean(axis=0) for piece in pieces]).reshape(-1, 2)
    radii = [
        np.linalg.norm(piece.vertices - center, axis=1).max() + piece.radius
        for piece, center in zip(pieces, centers, strict=True)
    ]
    packed = kernels.Pieces()
    vertices = np.concatenate([piece.vertices for piece in pieces]) if pieces else np.zeros((0, 2))
    packed.vertices = wp.array(vertices, dtype=wp.vec2, device=device)
    packed.first = wp.array(np.cumsum([0, *(len(piece.vertices) for piece in pieces)]), dtype=int, device=device)
    packed.center = wp.array(centers, dtype=wp.vec2, device=device)
    packed.reach = wp.array(np.array(radii, dtype=np.float32), dtype=float, device=device)
    packed.radius = wp.array(np.array([piece.radius for piece in pieces], np.float32), dtype=float, device=device)
    return packed
