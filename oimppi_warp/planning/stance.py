"""Construction of the stance field of an object; ``kernels/fields/stance.py`` explains it."""

from __future__ import annotations

import numpy as np
import shapely
import warp as wp

from oimppi_warp.compute.cache import cached, content_of
from oimppi_warp.compute.step import Compute
from oimppi_warp.geometry.fields import Geometry
from oimppi_warp.geometry.footprint import LimitSurface, footprint, outline
from oimppi_warp.kernels.fields.stance import StanceField, compute_stance
from oimppi_warp.scene import Scene

_STEP = 0.01
"""Grid step of the tool's position [m]."""
_BESIDE = 0.08
"""Extent of the grid beyond the object [m]."""
_AZIMUTHS, _ELEVATIONS = 24, 13
"""Directions of the object's motion: every 15 degrees."""
_DETOUR = 1.0
"""Way that a place of contact counts as more if its push is at right angles to the wanted motion [m]."""
_SWEEPS = 16
"""Sweeps over the grid, four in each direction: the way around an object bends a few times."""
_POINTS = 96
"""Points of the outline that are compared."""


class Outline:
    """Evenly spaced points on an object's outline, around its friction centre, and the pushes that they allow.

    Args:
        scene: The task.
        surface: Limit surface of the object.
        yaw_length: Length that a radian of yaw counts as [m].

    Attributes:
        shape: The outline.
        points, normals: Points [m] and inward unit normals there, shape [n, 2].
    """

    def __init__(self, scene: Scene, surface: LimitSurface, *, yaw_length: float) -> None:
        self._mobility = surface.mobility * surface.force
        self._metric = np.array([1.0, 1.0, yaw_length])
        self._friction = scene.object.tool_friction
        shape = outline(footprint(scene.object.colliders))
        self.shape = shapely.affinity.translate(shape, *(-surface.center))
        self.points, self.normals = _boundary(self.shape)

    def beside(self, distance: float) -> np.ndarray:
        """Returns the positions outside, at a distance [m] from each point, shape [n, 2] [m]."""
        return self.points - distance * self.normals

    def alignment(self, motions: np.ndarray) -> np.ndarray:
        """Scores a push at each point by its agreement with motions of the object.

        It is the cosine of the angle between the wanted twist and the twist ``x_o' = D w`` of equation 5, for the best
        force in the friction cone. A radian counts as ``yaw_length``, as in the distance that the push should reduce.

        Args:
            motions: Wanted motions (x, y, yaw) in the object's axes, of any length, shape [..., 3].

        Returns:
            Cosines, shape [..., n].
        """
        wanted = motions * self._metric
        wanted = wanted / np.maximum(np.linalg.norm(wanted, axis=-1, keepdims=True), 1e-9)
        best = np.full((*wanted.shape[:-1], len(self.points)), -1.0)
        for share in np.linspace(-1.0, 1.0, 5):
            best = np.maximum(best, wanted @ (self.twists(share) * self._metric).T)
        return best

    def twists(self, share: float) -> np.ndarray:
        """Returns the object's twists ``D w`` under a push at each point, in its axes, shape [n, 3] [m, m, rad].

        Their length is 1 m, where a radian counts as ``yaw_length``.

        Args:
            share: Tangential force, as a share of the largest that friction allows, from -1 to 1.
        """
        tangents = np.column_stack([-self.normals[:, 1], self.normals[:, 0]])
        force = self.normals + share * self._friction * tangents
        torque = self.points[:, 0] * force[:, 1] - self.points[:, 1] * force[:, 0]
        twist = np.column_stack([force, torque]) * self._mobility
        return twist / np.linalg.norm(twist * self._metric, axis=1)[:, None]


def build_stance(
    scene: Scene, geometry: Geometry, w_theta: float, device: str, *, threads: int | None = None
) -> StanceField:
    """Builds the stance field on a device, or reads it from the cache.

    Args:
        scene: The task.
        geometry: Shapes of the scene.
        w_theta: Square of the length that a radian of yaw counts as [m^2/rad^2]; 0 if the yaw does not matter.
        device: Warp device of the field.
        threads: Number of threads on the CPU, which computes it; ``None``: the number of cores.
    """
    cpu = Compute("cpu", threads=threads)
    length = yaw_length_of(geometry.surface, w_theta)
    rim = Outline(scene, geometry.surface, yaw_length=length)
    tool = scene.robot.tool_radius
    azimuth = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    elevation = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ELEVATIONS)[:, None]
    motions = np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation) / length + 0.0 * azimuth,
        ),
        axis=-1,
    ).reshape(-1, 3)
    places = rim.beside(tool)
    costs = _DETOUR * (1.0 - rim.alignment(motions))
    half = int(np.ceil((geometry.size + _BESIDE) / _STEP))
    origin = wp.vec2(-half * _STEP, -half * _STEP)
    body = geometry.body

    def compute() -> np.ndarray:
        values = wp.zeros((len(motions), 2 * half + 1, 2 * half + 1), dtype=float, device="cpu")
        host = type(body)()
        host.values, host.origin, host.inv_step = body.values.to("cpu"), body.origin, body.inv_step
        inputs = [
            host,
            wp.array(places.astype(np.float32), dtype=wp.vec2, device="cpu"),
            wp.array(costs.astype(np.float32), dtype=float, device="cpu"),
            tool,
            origin,
            _STEP,
            _SWEEPS,
        ]
        cpu.run(cpu.launch_samples(compute_stance, len(motions), inputs, [values]))
        return values.numpy()

    content = content_of(body.values.numpy(), body.origin, body.inv_step, places, costs, tool, half, _STEP, _SWEEPS)
    field = StanceField()
    field.values = wp.array(cached("stance", content, compute), dtype=float, device=device)
    field.origin, field.inv_step = origin, 1.0 / _STEP
    field.azimuths, field.elevations, field.yaw_length = _AZIMUTHS, _ELEVATIONS, length
    return field


def yaw_length_of(surface: LimitSurface, w_theta: float) -> float:
    """Returns the length that a radian of yaw counts as [m]: ``sqrt(w_theta)``.

    Where the yaw does not matter it is the radius of the limit surface, so that a push that turns the object instead of
    moving it does not count as a good one.
    """
    return float(np.sqrt(w_theta)) if w_theta > 0.0 else surface.radius


def no_stance(device: str) -> StanceField:
    """Returns an empty field, for a kernel that takes a field but does not read it with these settings."""
    field = StanceField()
    field.values = wp.zeros((0, 0, 0), dtype=float, device=device)
    return field


def _boundary(shape: shapely.Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Returns evenly spaced points on an outline [m] and its inward unit normals there, shape [n, 2] each."""
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
