"""Distance fields of a scene: computed once by kernels, cached by content, and looked up by every rollout.

- ``phi_2(x, y, yaw)``: clearance of the object to obstacles, the robot's base and the table's edge (the paper's gap
  function of object and environment, in equation 4), over poses of the object's friction centre.
- ``d_B(x, y)``: signed distance to the object's outline, in the frame of its friction centre (the paper's Example 1,
  in equation 7).
- the distance to the obstacles over space, for the arm and the tool (the paper's phi_3, in equation 4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import cast

import numpy as np
import shapely
import warp as wp

from oimppi_warp.compute.cache import cached, content_of
from oimppi_warp.compute.device import start_warp
from oimppi_warp.compute.step import Compute
from oimppi_warp.geometry.footprint import (
    LimitSurface,
    Piece,
    collider_mesh,
    core_points,
    footprint,
    height_range,
    limit_surface,
    outline,
)
from oimppi_warp.geometry.pose_grid import FURTHEST, PoseGrid, pack_pieces
from oimppi_warp.geometry.reach import object_bounds, stretched_length
from oimppi_warp.kernels.fields import distance as kernels
from oimppi_warp.kernels.geometry import PlanarField, PoseField, SpaceField
from oimppi_warp.kernels.upright_step import ASIDE
from oimppi_warp.scene import Collider, Scene

BODY_STEP = 0.002
"""Grid step of the object's own distance field [m]."""
NEAR = 0.05
"""Height above the highest obstacle from which the distance to obstacles is not looked up [m]."""
SPACE_STEP = 0.01
"""Grid step of the obstacles' distance field [m]."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """The planner's model of a scene's shapes, on one device.

    Attributes:
        surface: Limit surface of the object; the planner uses poses of its ``center``.
        top: Height of the object's top above the table [m].
        size: Largest distance of the outline from the friction centre [m].
        clearance: phi_2 over poses of the friction centre, to obstacles, the robot's base and the table's edge [m].
        obstruction: The same without the table's edge, which does not stop a pushed object [m].
        body: Signed distance to the object's outline around its friction centre [m].
        space: Distance to the obstacles [m].
        space_top: Height above which no obstacle is nearer than ``NEAR`` [m].
    """

    surface: LimitSurface
    top: float
    size: float
    clearance: PoseField
    obstruction: PoseField
    body: PlanarField
    space: SpaceField
    space_top: float

    def clearance_at(self, pose: np.ndarray) -> float:
        """Returns phi_2 at a pose [3] of the friction centre, looked up as the kernels do, on the host [m]."""
        return pose_field_at(self.clearance, pose, self._clearance_values)

    def obstruction_at(self, poses: np.ndarray) -> np.ndarray:
        """Returns phi_2 without the table's edge at poses [..., 3] of the friction centre, on the host, [...] [m]."""
        field = self.obstruction
        turns = poses[..., 2] / (2.0 * math.pi) % 1.0 * (len(self._obstruction_values) - 1)
        nodes = (poses[..., :2] - np.array(field.origin)) * field.inv_step
        return multilinear(self._obstruction_values, np.concatenate([turns[..., None], nodes], axis=-1))

    @cached_property
    def _clearance_values(self) -> np.ndarray:
        """Returns the values of phi_2's nodes on the host."""
        return self.clearance.values.numpy()

    @cached_property
    def _obstruction_values(self) -> np.ndarray:
        """Returns the values of the other field's nodes on the host; the first yaw is repeated after the last."""
        values = self.obstruction.values.numpy()
        return np.concatenate([values, values[:1]])


def multilinear(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolates values on a regular grid linearly along each axis; beyond the grid, its border counts.

    Args:
        values: Values at the nodes, an array of d axes.
        at: Points, in grid steps from the first node, finite, shape [..., d].

    Returns:
        Shape [...].
    """
    at = np.clip(at, 0.0, np.array(values.shape) - 1.0)
    node = np.minimum(at.astype(int), np.array(values.shape) - 2)
    share = at - node
    found = np.zeros(at.shape[:-1])
    for corner in product((0, 1), repeat=values.ndim):
        weight = np.where(corner, share, 1.0 - share).prod(axis=-1)
        found += weight * values[tuple(np.moveaxis(node + corner, -1, 0))]
    return found


def pose_field_at(field: PoseField, pose: np.ndarray, values: np.ndarray | None = None) -> float:
    """Looks up a pose field on the host, trilinearly as the kernels do; NaN if the pose is not finite.

    Args:
        field: The field.
        pose: A planar pose, shape [3].
        values: The field's values on the host, if they are at hand; ``None``: they are copied from the device.
    """
    px, py, yaw = pose.tolist()
    if not math.isfinite(px + py + yaw):
        return float("nan")
    values = field.values.numpy() if values is None else values
    nyaw, nx, ny = values.shape
    x = min(max((px - field.origin[0]) * field.inv_step, 0.0), nx - 1 - 1e-3)
    y = min(max((py - field.origin[1]) * field.inv_step, 0.0), ny - 1 - 1e-3)
    t = (yaw / (2.0 * math.pi)) % 1.0 * nyaw
    i, j, k = int(x), int(y), int(t) % nyaw
    ax, ay, at = x - i, y - j, t - int(t)
    (a00, a01), (a10, a11) = values[k, i : i + 2, j : j + 2].tolist()
    (b00, b01), (b10, b11) = values[(k + 1) % nyaw, i : i + 2, j : j + 2].tolist()
    low = (1.0 - ay) * ((1.0 - at) * a00 + at * b00) + ay * ((1.0 - at) * a01 + at * b01)
    high = (1.0 - ay) * ((1.0 - at) * a10 + at * b10) + ay * ((1.0 - at) * a11 + at * b11)
    return (1.0 - ax) * low + ax * high


def planar_field_at(field: PlanarField, point: np.ndarray, values: np.ndarray) -> float:
    """Looks up a planar field on the host, bilinearly and clamped outside, as the kernels do.

    Args:
        field: The field.
        point: Position, shape [2] [m].
        values: The field's values on the host.
    """
    nx, ny = values.shape
    x = min(max((float(point[0]) - field.origin[0]) * field.inv_step, 0.0), nx - 1 - 1e-3)
    y = min(max((float(point[1]) - field.origin[1]) * field.inv_step, 0.0), ny - 1 - 1e-3)
    i, j = int(x), int(y)
    low = values[i, j] + (y - j) * (values[i, j + 1] - values[i, j])
    high = values[i + 1, j] + (y - j) * (values[i + 1, j + 1] - values[i + 1, j])
    return float(low + (x - i) * (high - low))


def build_geometry(scene: Scene, device: str, *, threads: int | None = None) -> Geometry:
    """Builds all distance fields of a scene, or reads them from the cache.

    Args:
        scene: The task.
        device: Warp device of the fields.
        threads: Number of threads on the CPU, which computes them; ``None``: the number of cores.
    """
    start_warp()
    cpu = Compute("cpu", threads=threads)
    surface = limit_surface(scene.object)
    body, pieces, top = _footprints(scene, surface)
    obstacles = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
    grid = PoseGrid(body, pieces, scene, cpu)
    clearance, obstruction = (grid.field(values, device) for values in (grid.clearance(), grid.obstruction))
    size = max(float(np.linalg.norm(piece.vertices, axis=1).max()) + piece.radius for piece in body)
    space, space_top = _space_field(obstacles, scene, device, cpu)
    return Geometry(
        surface, top, size, clearance, obstruction, _body_field(body, scene.robot.tool_radius, device), space, space_top
    )


def exact_nodes(scene: Scene) -> np.ndarray:
    """Returns the exact phi_2 at the nodes of its grid, from which the planner's field differs at corners [m].

    Args:
        scene: The task.

    Returns:
        Shape [yaw, x, y], at the nodes of ``build_geometry(scene, ...).clearance``.
    """
    start_warp()
    body, pieces, _ = _footprints(scene, limit_surface(scene.object))
    return PoseGrid(body, pieces, scene, Compute("cpu")).exact()


class ExactClearance:
    """phi_2 computed from the footprints, not looked up on a grid.

    Args:
        scene: The task.
    """

    def __init__(self, scene: Scene) -> None:
        start_warp()
        self._surface = limit_surface(scene.object)
        body, obstacles, _ = _footprints(scene, self._surface)
        lower, upper = object_bounds(scene)
        self._pose, self._value = (wp.zeros(1, dtype=kind, device="cpu") for kind in (wp.vec3, float))
        inputs = [pack_pieces(body, "cpu"), pack_pieces(obstacles, "cpu"), wp.vec2(*lower), wp.vec2(*upper)]
        inputs += [self._pose, FURTHEST]
        self._launch = wp.launch(
            kernels.pose_clearance, dim=1, inputs=inputs, outputs=[self._value], device="cpu", record_cmd=True
        )

    def at(self, pose: np.ndarray) -> float:
        """Returns the clearance at a planar pose of the object's frame, shape [3] [m]; NaN if it is not finite.

        It is the distance to obstacles, the robot's base and the table's edge, at most :data:`FURTHEST`; negative, it
        is the depth of penetration.
        """
        if not np.isfinite(pose).all():
            return float("nan")
        self._pose.numpy()[0] = to_center(self._surface, pose)
        self._launch.launch()
        return float(self._value.numpy()[0])


def to_center(surface: LimitSurface, pose: np.ndarray) -> np.ndarray:
    """Converts planar poses of the object's frame to those of its friction centre, shape [..., 3] [m, m, rad]."""
    return _translated(pose, surface.center)


def from_center(surface: LimitSurface, pose: np.ndarray) -> np.ndarray:
    """Converts planar poses of the object's friction centre to those of its frame, shape [..., 3] [m, m, rad]."""
    return _translated(pose, -surface.center)


def _translated(pose: np.ndarray, offset: np.ndarray) -> np.ndarray:
    moved = np.array(pose, dtype=float)
    c, s = np.cos(moved[..., 2]), np.sin(moved[..., 2])
    moved[..., 0] += c * offset[0] - s * offset[1]
    moved[..., 1] += s * offset[0] + c * offset[1]
    return moved


def _footprints(scene: Scene, surface: LimitSurface) -> tuple[list[Piece], tuple[Piece, ...], float]:
    """Returns the pieces of the object around its friction centre and of what it may meet, and its top's height [m]."""
    body = [_shifted(piece, -surface.center) for piece in footprint(scene.object.colliders)]
    low, high = height_range(scene.object.colliders)
    lower, top = scene.object.rest_height + low, scene.object.rest_height + high
    obstacles = [collider for obstacle in scene.obstacles for collider in obstacle.colliders]
    return body, footprint((*obstacles, *scene.robot.base.colliders), lower=lower + 1e-3, upper=top), top


def _shifted(piece: Piece, offset: np.ndarray) -> Piece:
    return Piece(piece.vertices + offset, piece.radius)


def _body_field(pieces: list[Piece], tool_radius: float, device: str) -> PlanarField:
    shape = outline(pieces)
    # Beyond the margin the field is cut off, which must look neither like contact nor like a tool over the object.
    margin = max(2.0 * tool_radius, tool_radius + ASIDE + 2.0 * BODY_STEP, 0.02)
    x0, y0, x1, y1 = shape.bounds
    xs = np.arange(x0 - margin, x1 + margin + BODY_STEP, BODY_STEP)
    ys = np.arange(y0 - margin, y1 + margin + BODY_STEP, BODY_STEP)
    points = shapely.points(*np.meshgrid(xs, ys, indexing="ij"))
    shapely.prepare(shape)
    distance = shapely.distance(points, shape.boundary)
    values = np.where(shapely.contains(shape, points), -distance, distance)
    field = PlanarField()
    field.values = wp.array(values.astype(np.float32), dtype=float, device=device)
    field.origin = wp.vec2(xs[0], ys[0])
    field.inv_step = 1.0 / BODY_STEP
    return field


def _space_field(obstacles: list[Collider], scene: Scene, device: str, cpu: Compute) -> tuple[SpaceField, float]:
    field = SpaceField()
    field.inv_step = 1.0 / SPACE_STEP
    field.outside = FURTHEST
    if not obstacles:
        field.values = wp.full((2, 2, 2), FURTHEST, dtype=float, device=device)
        field.origin = wp.vec3(1e3, 1e3, 1e3)
        return field, -1.0

    cores = [core_points(collider) for collider in obstacles]
    lowest = np.min([points.min(axis=0) - radius for points, radius in cores], axis=0)
    highest = np.max([points.max(axis=0) + radius for points, radius in cores], axis=0)
    reach = stretched_length(scene.robot)
    lower = np.maximum(lowest - FURTHEST, [-reach, -reach, 0.0])
    upper = np.minimum(highest + FURTHEST, [reach, reach, 2.0])
    count = np.maximum(np.ceil((upper - lower) / SPACE_STEP).astype(int) + 1, 2)

    def compute() -> np.ndarray:
        import trimesh

        mesh = cast(trimesh.Trimesh, trimesh.util.concatenate([collider_mesh(collider) for collider in obstacles]))
        values = wp.zeros(tuple(count), dtype=float, device="cpu")
        closed = wp.Mesh(
            points=wp.array(mesh.vertices, dtype=wp.vec3, device="cpu"),
            indices=wp.array(mesh.faces.ravel(), dtype=int, device="cpu"),
            support_winding_number=True,
        )
        inputs = [closed.id, wp.vec3(*lower), SPACE_STEP, FURTHEST]
        cpu.run(cpu.launch_samples(kernels.space_distance, values.size, inputs, [values]))
        return values.numpy()

    content = content_of(*(part for core in cores for part in core), lower, count, SPACE_STEP, FURTHEST)
    field.values = wp.array(cached("space", content, compute), dtype=float, device=device)
    field.origin = wp.vec3(*lower)
    return field, float(highest[2]) + NEAR
