"""Colliders seen from above: planar geometry, friction centre and limit surface.

Pushing on a table is planar. An object's footprint is the vertical projection of its colliders, a union of convex
pieces; the planner's whole model of its shape is derived from it here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, cast

import numpy as np
import shapely
from shapely.geometry import MultiPoint, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from oimppi_warp.scene import Collider, PlanarPose, PushedObject

if TYPE_CHECKING:
    import trimesh

GRAVITY = 9.81
"""Gravitational acceleration [m/s^2]."""

_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)


@dataclass(frozen=True, eq=False)
class Piece:
    """A convex polygon grown by a radius: all points within ``radius`` of its core.

    Attributes:
        vertices: Core, counter-clockwise, shape [n, 2] [m]: a polygon, or one vertex, which makes a disc.
        radius: Radius that the core is grown by [m].
    """

    vertices: np.ndarray
    radius: float = 0.0

    def polygon(self) -> BaseGeometry:
        """Returns the piece as a shapely geometry (rounded corners have 64 segments per full circle)."""
        return MultiPoint(self.vertices).convex_hull.buffer(self.radius, quad_segs=16)

    def moved(self, pose: PlanarPose | np.ndarray) -> Piece:
        """Transforms the piece from the frame ``pose`` to the frame in which ``pose`` is given."""
        return Piece(planar_points(pose, self.vertices), self.radius)


@dataclass(frozen=True, eq=False)
class LimitSurface:
    """Ellipsoidal limit surface of an object on the table.

    Under quasi-static motion a wrench ``w`` (at ``center``, object frame) moves the object with the twist
    ``x_o' = D w``, ``D = diag(mu m g, mu m g, c r mu m g)^-1`` (equation 5). The ellipsoid's axes are the friction
    force ``mu m g`` and the friction torque ``radius * mu m g``, so that the paper's ``c r`` is ``radius ** 2`` here.

    Attributes:
        center: Friction centre in the object's frame, shape [2] [m].
        radius: Friction torque over friction force [m].
        force: mu m g [N].
    """

    center: np.ndarray
    radius: float
    force: float

    @property
    def mobility(self) -> np.ndarray:
        """Returns the mobility's diagonal, shape [3]: ``D = diag(mu m g, mu m g, radius^2 mu m g)^-1`` (equation 5).

        The units are m/(N s), m/(N s) and rad/(N m s).
        """
        return np.array([1.0, 1.0, 1.0 / self.radius**2]) / self.force


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Returns the rotation matrix of a unit quaternion (x, y, z, w), shape [3, 3]."""
    x, y, z, w = np.asarray(quaternion, dtype=float)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns Hamilton's product of quaternions xyzw, the rotation ``b`` followed by ``a``, shape [4]."""
    return np.concatenate([a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3]), [a[3] * b[3] - a[:3] @ b[:3]]])


def transform_points(transform: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transforms points, shape [n, 3] [m], by a transform (position [m], quaternion xyzw), shape [7]."""
    return np.atleast_2d(points) @ rotation_matrix(transform[3:]).T + transform[:3]


def planar_points(pose: PlanarPose | np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transforms points, shape [n, 2] [m], by a planar pose (x, y, yaw) [m, m, rad]."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.atleast_2d(points) @ np.array([[c, s], [-s, c]]) + np.asarray(pose[:2])


def wrap_angle(angle: float | np.ndarray) -> np.ndarray:
    """Wraps an angle to [-pi, pi) [rad]."""
    return (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi


def core_points(collider: Collider) -> tuple[np.ndarray, float]:
    """Returns points and a radius that describe a collider: the convex hull of the points, grown by the radius.

    A cylinder is replaced by an inscribed prism with 32 points on each rim, which loses at most 0.5 % of the radius.

    Returns:
        Points in the body's frame [n, 3] [m], and the radius [m].
    """
    radius = 0.0
    if collider.kind == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        points = corners * np.asarray(collider.size)
    elif collider.kind == "sphere":
        points, radius = np.zeros((1, 3)), collider.size[0]
    elif collider.kind == "capsule":
        points, radius = np.array([[0.0, 0.0, -collider.size[1]], [0.0, 0.0, collider.size[1]]]), collider.size[0]
    elif collider.kind == "cylinder":
        rim = collider.size[0] * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE), np.zeros_like(_CIRCLE)], axis=1)
        points = np.concatenate([rim - [0, 0, collider.size[1]], rim + [0, 0, collider.size[1]]])
    else:
        assert collider.vertices is not None
        points = np.asarray(collider.vertices, dtype=float)
    return transform_points(collider.transform, points), radius


def collider_mesh(collider: Collider) -> trimesh.Trimesh:
    """Returns the collider as a closed convex mesh in its body's frame [m]; cylinders have 32 sides."""
    import trimesh  # takes half a second, and scenes whose fields are in the cache do without

    points, radius = core_points(collider)
    if radius > 0.0:
        ball = trimesh.creation.icosphere(subdivisions=2, radius=radius).vertices
        points = (points[:, None, :] + ball[None, :, :]).reshape(-1, 3)
    return trimesh.convex.convex_hull(points)


def height_range(colliders: Iterable[Collider]) -> tuple[float, float]:
    """Returns the lowest and highest z of the colliders in their body's frame [m]."""
    cores = [core_points(collider) for collider in colliders]
    return min(p[:, 2].min() - r for p, r in cores), max(p[:, 2].max() + r for p, r in cores)


def _piece(collider: Collider) -> Piece:
    points, radius = core_points(collider)
    upright = abs(rotation_matrix(collider.transform[3:])[2, 2]) > 1.0 - 1e-9
    if collider.kind == "cylinder" and upright:
        return Piece(collider.transform[None, :2].astype(float), collider.size[0])
    hull = MultiPoint(np.round(points[:, :2], 9)).convex_hull
    if hull.geom_type == "Point":
        return Piece(np.asarray(hull.coords), radius)
    if hull.geom_type == "LineString":  # a lying capsule has no polygon to grow: use its outline
        hull, radius = hull.buffer(max(radius, 1e-4), quad_segs=8), 0.0
    return Piece(np.asarray(orient(cast(Polygon, hull)).exterior.coords)[:-1], radius)


def footprint(colliders: Iterable[Collider], *, lower: float = -np.inf, upper: float = np.inf) -> tuple[Piece, ...]:
    """Projects the colliders that reach into a height range onto the horizontal plane.

    Args:
        colliders: Shapes in their body's frame (obstacles: world frame).
        lower, upper: Height range; shapes entirely outside it are left out [m].

    Returns:
        One convex piece for each collider, in the frame's x-y plane.
    """
    pieces = []
    for collider in colliders:
        low, high = height_range([collider])
        if high > lower and low < upper:
            pieces.append(_piece(collider))
    return tuple(pieces)


def outline(pieces: Iterable[Piece]) -> BaseGeometry:
    """Returns the union of the pieces, in their frame, as a shapely geometry [m]."""
    return shapely.union_all([piece.polygon() for piece in pieces])


def limit_surface(body: PushedObject, *, support: Literal["corners", "area"] = "corners") -> LimitSurface:
    """Computes the limit surface of an object that rests on its footprint: ``mu m g`` and ``c r`` of equation 5.

    Unless the scene gives the radius (``limit_surface_radius``), the torque limit is the integral of ``mu p |r - r_c|``
    over the support, that is ``mu m g`` times the mean distance of the support to the friction centre, which is the
    centre of mass seen from above. It depends on the distribution of the pressure ``p``: a rigid body on a rigid table
    rests on the corners of its pieces, as it does in contact engines; the other common assumption is uniform pressure
    over the area. For the T block they give 0.085 and 0.057 m; pushes of the simulated T agree best with 0.08 to 0.09 m
    (``tests/planning/test_parity.py``).

    Args:
        body: The object.
        support: Points that carry the object with equal pressure: the corners of its pieces, or their whole area.
    """
    center = np.asarray(body.center_of_mass[:2], dtype=float)
    force = body.friction * body.mass * GRAVITY
    if body.limit_surface_radius is not None:
        return LimitSurface(center, body.limit_surface_radius, force)
    pieces = footprint(body.colliders)
    if support == "corners":
        rims = [piece.vertices if piece.radius == 0.0 else _rim(piece) for piece in pieces]
        points = np.concatenate(rims)
    else:
        points = _grid_inside(outline(pieces), count=4000)
    radius = float(np.linalg.norm(points - center, axis=1).mean())
    return LimitSurface(center, radius, force)


def _rim(piece: Piece) -> np.ndarray:
    """Returns points on the outline of a rounded piece, shape [n, 2] [m]."""
    return np.asarray(cast(Polygon, piece.polygon()).exterior.coords)[:-1]


def _grid_inside(shape: BaseGeometry, *, count: int) -> np.ndarray:
    """Returns about ``count`` points of a square grid inside a planar shape, shape [n, 2] [m]."""
    x0, y0, x1, y1 = shape.bounds
    step = np.sqrt(shape.area / count)
    xs, ys = np.meshgrid(np.arange(x0 + step / 2, x1, step), np.arange(y0 + step / 2, y1, step))
    points = np.stack([xs.ravel(), ys.ravel()], axis=1)
    return points[shapely.contains_xy(shape, points)]
