"""Decomposes a closed surface into convex pieces, in a limited time, and measures how closely they match it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import shapely
import trimesh
from scipy.spatial import KDTree
from shapely.geometry.base import BaseGeometry

from oimppi_warp.authoring.meshes.coacd_run import run_coacd
from oimppi_warp.authoring.meshes.coarse import coarsened
from oimppi_warp.authoring.meshes.hulls import Hull, limited_hull
from oimppi_warp.authoring.meshes.moments import moments, points_in_box

THRESHOLDS = (0.05, 0.02)
"""Concavity thresholds for CoACD, coarse to fine; the first whose result is close enough is used."""

CLOSE_ENOUGH = (0.04, 0.04, 0.004)
"""Tolerances for a close enough fit: relative errors of the volume and of the footprint, and surface distance [m]."""

FAR_OFF = (0.1, 0.1, 0.005)
"""Errors of the same kinds from which on a fit is warned of."""

PIECES, CORNERS = 32, 200
"""Maximum number of pieces of an object, and of corners of a piece."""

FINE, COARSE = 6000, 3000
"""A part with more triangles, a scan, is reduced to fewer before it is cut: cutting it directly would take minutes."""

QUICK = {"preprocess_mode": "off", "mcts_iterations": 25, "mcts_nodes": 10, "resolution": 1000}
"""CoACD's options for such a part: it is cut as it is, not remeshed on a grid, which would thicken it, and fewer cuts
are tried."""

SECONDS = 13.0
"""Computing time that cutting may take in all [s]; then the best pieces found so far are used."""

_FINER = 2.0  # how much longer the next finer threshold takes, at least
_FLAT = 1e-4
"""Thickness, summed over its points, below which a piece is flat [m]."""
_POINTS = 60_000  # for sampling a volume
_ON_SURFACE = 8000  # for sampling a distance


MEASURED = 8000
"""Number of triangles to which a surface is reduced to measure the area that it covers."""


@dataclass(frozen=True, eq=False)
class Job:
    """A part to be cut.

    Attributes:
        solid: Its surface, perhaps reduced [m].
        pieces: Maximum number of pieces.
        reduced: Whether it was reduced.
    """

    solid: trimesh.Trimesh
    pieces: int
    reduced: bool


@dataclass(frozen=True)
class Fit:
    """Closeness of convex pieces to the mesh that they represent.

    Attributes:
        volume: Volume of their union relative to the mesh's, minus one.
        footprint: Area of the table covered by only one of the two, relative to the mesh's.
        distance: Sampled Hausdorff distance [m]: from the mesh's surface to the pieces, or from parts of them that
            protrude to the mesh. Slits between pieces inside the mesh do not count, as nothing can enter them.
        stopped: Whether the pieces are whole parts, since cutting them took too long.
    """

    volume: float
    footprint: float
    distance: float
    stopped: bool = False

    @property
    def is_close(self) -> bool:
        """Returns whether the fit is good enough to stop refining."""
        return (
            abs(self.volume) < CLOSE_ENOUGH[0] and self.footprint < CLOSE_ENOUGH[1] and self.distance < CLOSE_ENOUGH[2]
        )

    @property
    def is_far_off(self) -> bool:
        """Returns whether an error is so large that pushes of the pieces are not those of the mesh."""
        return abs(self.volume) > FAR_OFF[0] or self.footprint > FAR_OFF[1] or self.distance > FAR_OFF[2]

    def __str__(self) -> str:
        """Describes the three errors in words."""
        return (
            f"volume {100 * self.volume:+.1f} %, footprint {100 * self.footprint:.1f} %, "
            f"at most {1000 * self.distance:.1f} mm off"
        )


def decompose(
    mesh: trimesh.Trimesh, *, progress: Callable[[float], None] = lambda _: None, seconds: float = SECONDS
) -> tuple[tuple[Hull, ...], Fit]:
    """Cuts a closed surface into convex pieces with CoACD (Wei et al., 2022).

    The decomposition is refined until the pieces are :data:`CLOSE_ENOUGH` to the mesh or number :data:`PIECES`, or the
    time is over.

    Args:
        mesh: A closed surface [m].
        progress: Called with the share of the time that is over, from 0 to 1.
        seconds: Computing time that the cutting may take [s].

    Returns:
        The pieces, and how closely they match the mesh.

    Raises:
        SceneError: CoACD failed.
    """
    solids = mesh.split(only_watertight=False)
    jobs = [
        Job(solid if len(solid.faces) <= FINE else coarsened(solid, COARSE), pieces, len(solid.faces) > FINE)
        for solid, pieces in zip(solids, _piece_budgets(solids), strict=True)
    ]
    target, best, before = Target.of(mesh), None, 0.0
    for threshold in THRESHOLDS:
        share = functools.partial(_share, progress, before, seconds)
        hulls, used = _cut(jobs, threshold, seconds - before, share)
        before += used
        if hulls is None:
            break
        fit = target.fit(hulls)
        if best is None or fit.footprint + fit.distance < best[1].footprint + best[1].distance:
            best = hulls, fit
        if fit.is_close or len(hulls) >= PIECES or before + _FINER * used > seconds:
            break
    if best is None:  # nothing was found in time
        hulls = tuple(limited_hull(solid.vertices, CORNERS) for solid in solids)
        best = hulls, replace(target.fit(hulls), stopped=True)
    progress(1.0)
    return best


def _share(progress: Callable[[float], None], before: float, seconds: float, used: float) -> None:
    """Tells the progress that a time [s] makes of all, after the time of what was done before [s]."""
    progress(min((before + used) / max(seconds, 1e-9), 1.0))


def _piece_budgets(solids: Sequence[trimesh.Trimesh]) -> list[int]:
    """Allots each part a maximum number of pieces, :data:`PIECES` in all; any remainder goes to the hollowest parts."""
    lacking = np.array([0.0 if each.is_convex else each.convex_hull.volume - each.volume for each in solids])
    budgets, hollow = np.ones(len(solids), dtype=int), np.argsort(-lacking, kind="stable")[: (lacking > 0.0).sum()]
    for number in range(PIECES - len(solids) if len(hollow) else 0):
        budgets[hollow[number % len(hollow)]] += 1
    return budgets.tolist()


def _cut(
    jobs: list[Job], threshold: float, seconds: float, waiting: Callable[[float], None]
) -> tuple[tuple[Hull, ...] | None, float]:
    """Returns the convex pieces of all parts, or ``None`` if that takes too long, and the computing time [s].

    Args:
        jobs: The parts.
        threshold: Concavity threshold.
        seconds: Computing time that it may take [s].
        waiting: Called again and again with the computing time that it took so far [s].
    """
    hard = [job for job in jobs if not job.solid.is_convex and job.pieces > 1]
    options = [{"threshold": threshold, "max_convex_hull": job.pieces, "seed": 0} for job in hard]
    options = [each | QUICK if job.reduced else each for each, job in zip(options, hard, strict=True)]
    found, used = run_coacd([job.solid for job in hard], options, seconds, waiting) if hard else ([], 0.0)
    if found is None:
        return None, used
    by_job = {id(job): pieces for job, pieces in zip(hard, found, strict=True)}
    hulls: list[Hull] = []
    for job in jobs:
        pieces = [corners for corners in by_job.get(id(job), []) if _spans_volume(corners)]
        hulls += [limited_hull(corners, CORNERS) for corners in pieces or [job.solid.vertices]]
    return tuple(hulls), used


def _spans_volume(points: np.ndarray) -> bool:
    """Returns whether points, as they are written, span a volume; the cutting may leave flat slivers."""
    rounded = np.round(points, 5)
    if len(rounded) < 4:
        return False
    return bool(np.linalg.svd(rounded - rounded.mean(axis=0), compute_uv=False)[-1] > _FLAT)


@dataclass(frozen=True, eq=False)
class Target:
    """A closed surface that convex pieces are compared with.

    Attributes:
        mesh: The surface [m].
        volume: The volume that it encloses [m^3].
        covered: The area of the table that it covers, seen from above.
    """

    mesh: trimesh.Trimesh
    volume: float
    covered: BaseGeometry

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> Target:
        """Returns the target for a surface; the covered area of a scan is that of the surface with fewer triangles."""
        coarse = coarsened(mesh, MEASURED)
        return Target(mesh, moments(mesh).volume, vertical_projection(coarse.vertices, coarse.faces))

    def fit(self, hulls: tuple[Hull, ...]) -> Fit:
        """Measures how closely convex pieces match the surface."""
        mesh, covered = self.mesh, self.covered
        projection = shapely.union_all([_hull_projection(h) for h in hulls])
        footprint = shapely.area(shapely.symmetric_difference(covered, projection)) / shapely.area(covered)
        volume = _volume_of_union(hulls) / self.volume - 1.0
        whole = cast(trimesh.Trimesh, trimesh.util.concatenate([trimesh.Trimesh(*hull) for hull in hulls]))
        corners = mesh.vertices[:: max(1, len(mesh.vertices) // _ON_SURFACE)]
        lost = distances(whole, np.vstack([_sampled(mesh, _ON_SURFACE, 0)[0], corners]))
        gained = -signed_depths(mesh, np.vstack([_sampled(whole, _ON_SURFACE, 0)[0], whole.vertices]))
        return Fit(float(volume), float(footprint), float(max(lost.max(), gained.max(initial=0.0))))


def compare(mesh: trimesh.Trimesh, hulls: tuple[Hull, ...]) -> Fit:
    """Measures how closely convex pieces match the closed surface that they represent."""
    return Target.of(mesh).fit(hulls)


def vertical_projection(vertices: np.ndarray, faces: np.ndarray) -> BaseGeometry:
    """Returns the area of the table that triangles cover, seen from above."""
    triangles = vertices[faces][:, :, :2]
    (ux, uy), (vx, vy) = (triangles[:, 1] - triangles[:, 0]).T, (triangles[:, 2] - triangles[:, 0]).T
    return shapely.union_all(shapely.polygons(triangles[np.abs(ux * vy - uy * vx) > 1e-12]), grid_size=1e-6)


def _hull_projection(hull: Hull) -> BaseGeometry:
    return shapely.MultiPoint(hull[0][:, :2]).convex_hull


def distances(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Returns the distances of points, shape [n, 3] [m], to a surface, shape [n] [m]."""
    return np.abs(signed_depths(mesh, points))


def signed_depths(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Returns the depths of points, shape [n, 3] [m], below a surface (negative above it), shape [n] [m].

    Only the triangles around the nearest samples of the surface are examined; the depth is exact if the nearest
    triangle is one of them.

    Where an edge or a corner is nearest, its triangles are equally distant; the one whose plane the point is farthest
    from decides the side.
    """
    samples, owner = _sampled(mesh, 4 * _ON_SURFACE, 1)
    samples = np.vstack([samples, mesh.triangles_center])
    owner = np.concatenate([owner, np.arange(len(mesh.faces))])
    _, near = KDTree(samples).query(points, k=min(20, len(samples)))
    candidates = owner[near]
    repeated = np.repeat(points, candidates.shape[1], axis=0)
    closest = trimesh.triangles.closest_point(mesh.triangles[candidates.ravel()], repeated)
    away = (repeated - closest).reshape(*candidates.shape, 3)
    far = np.linalg.norm(away, axis=-1)
    nearest = far.min(axis=1)
    lift = np.einsum("nki,nki->nk", away, mesh.face_normals[candidates])
    decisive = np.where(far < nearest[:, None] + 1e-9, np.abs(lift), -1.0).argmax(axis=1)
    above = lift[np.arange(len(points)), decisive] > 0.0
    return np.where(above, -1.0, 1.0) * nearest


def _sampled(mesh: trimesh.Trimesh, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns sampled points on a surface [n, 3] [m], and the triangle that each lies on [n]."""
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)[:2]
    return np.asarray(points), np.asarray(faces)


def _volume_of_union(hulls: tuple[Hull, ...]) -> float:
    """Returns the volume of the union of convex pieces [m^3]: their sum minus the overlaps, which are sampled."""
    total = sum(float(trimesh.Trimesh(*hull).volume) for hull in hulls)
    if len(hulls) == 1:
        return total
    every = np.vstack([corners for corners, _ in hulls])
    points, box = points_in_box(np.array([every.min(axis=0), every.max(axis=0)]), _POINTS)
    times = sum((_depth(hull, points) > 0.0).astype(int) for hull in hulls)
    return total - float(box * np.maximum(times - 1, 0).mean())


def _depth(hull: Hull, points: np.ndarray) -> np.ndarray:
    """Returns the depths of points inside a piece [m]; negative outside."""
    shell = trimesh.Trimesh(*hull, process=False)
    inward = np.einsum("fi,fi->f", shell.face_normals, shell.triangles[:, 0]) - points @ shell.face_normals.T
    return inward.min(axis=1)
