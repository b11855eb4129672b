"""Meshes like those of scanned household things: tens of thousands of triangles, noisy, with holes underneath."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh
import warp as wp


def _capsule(p: np.ndarray, a, b, radius: float) -> np.ndarray:
    """Distance to a capsule from ``a`` to ``b`` [m]."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(p - a - share[..., None] * (b - a), axis=-1) - radius


def _box(p: np.ndarray, center, half, rounding: float = 0.004) -> np.ndarray:
    """Distance to a box with rounded edges [m]."""
    q = np.abs(p - np.asarray(center)) - np.asarray(half) + rounding
    return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(axis=-1), 0.0) - rounding


def _pillar(p: np.ndarray, radius: float, low: float, high: float, rounding: float = 0.003) -> np.ndarray:
    """Distance to an upright cylinder on the z axis with a rounded rim [m]."""
    across = np.linalg.norm(p[..., :2], axis=-1) - radius + rounding
    along = np.abs(p[..., 2] - (low + high) / 2.0) - (high - low) / 2.0 + rounding
    q = np.stack([across, along], axis=-1)
    return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(axis=-1), 0.0) - rounding


def _blend(*fields: np.ndarray, width: float = 0.008) -> np.ndarray:
    """A union with smooth seams."""
    return -width * np.log(sum(np.exp(-field / width) for field in fields))


def _banana(p: np.ndarray) -> np.ndarray:
    bends = [(0.09 * np.cos(t), 0.09 * np.sin(t) - 0.05, 0.0) for t in np.linspace(0.3, np.pi - 0.3, 9)]
    radii = 0.019 * np.sin(np.linspace(0.55, np.pi - 0.45, 8)) + 0.001
    return _blend(*(_capsule(p, *ends, r) for *ends, r in zip(bends, bends[1:], radii, strict=False)), width=0.003)


def _mug(p: np.ndarray) -> np.ndarray:
    wall = np.maximum(_pillar(p, 0.042, -0.04, 0.04), -_pillar(p, 0.037, -0.034, 0.1))
    turns = [(0.045 + 0.025 * np.sin(t), 0.0, 0.026 * np.cos(t)) for t in np.linspace(0.1, np.pi - 0.1, 7)]
    handle = np.min([_capsule(p, *ends, 0.0055) for ends in pairwise(turns)], axis=0)
    return np.minimum(wall, np.maximum(handle, -_pillar(p, 0.037, -0.034, 0.1)))


def _drill(p: np.ndarray) -> np.ndarray:
    body = _capsule(p, (-0.07, 0.0, 0.05), (0.05, 0.0, 0.05), 0.027)
    chuck = _capsule(p, (0.05, 0.0, 0.05), (0.085, 0.0, 0.05), 0.012)
    grip = _capsule(p, (-0.04, 0.0, 0.04), (-0.06, 0.0, -0.05), 0.018)
    return _blend(body, chuck, grip, _box(p, (-0.05, 0.0, -0.075), (0.045, 0.03, 0.018)))


def _bowl(p: np.ndarray) -> np.ndarray:
    ball = np.linalg.norm(p - (0.0, 0.0, 0.05), axis=-1)
    shell = np.maximum(ball - 0.08, 0.074 - ball)
    return np.maximum(shell, p[..., 2] - 0.03)


def _clamp(p: np.ndarray) -> np.ndarray:
    frame = np.minimum(
        _box(p, (0.0, -0.04, 0.0), (0.06, 0.009, 0.012)), _box(p, (-0.05, 0.0, 0.0), (0.01, 0.045, 0.012))
    )
    frame = np.minimum(frame, _box(p, (0.05, 0.0, 0.0), (0.01, 0.045, 0.012)))
    return np.minimum(frame, _capsule(p, (-0.02, 0.032, 0.0), (0.1, 0.032, 0.0), 0.007))


def _bottle(p: np.ndarray) -> np.ndarray:
    return _blend(
        _pillar(p, 0.035, -0.09, 0.04), _pillar(p, 0.014, 0.0, 0.085), _box(p, (0.025, 0.0, 0.08), (0.03, 0.011, 0.011))
    )


def _carton(p: np.ndarray) -> np.ndarray:
    return _box(p, (0.0, 0.0, 0.0), (0.08, 0.03, 0.105), 0.002)


SCANS = {
    "banana": _banana,
    "mug": _mug,
    "drill": _drill,
    "bowl": _bowl,
    "clamp": _clamp,
    "bottle": _bottle,
    "carton": _carton,
}
"""Signed distance fields [m] about the origin."""


def scan(kind: str, *, cells: int = 110, noise: float = 2e-4, holes: int = 3, seed: int = 0) -> trimesh.Trimesh:
    """A scan of one of :data:`SCANS`.

    Args:
        kind: What is scanned.
        cells: Cells of the scanner's grid along the longest side: 110 give some 50,000 triangles.
        noise: Standard deviation of the noise along the normals [m].
        holes: Number of holes of about 1 cm on the underside.
        seed: Seed of the noise and the holes.
    """
    random = np.random.default_rng(seed)
    axis = np.linspace(-0.13, 0.13, 60)
    rough = SCANS[kind](np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1))
    inside = np.argwhere(rough < axis[1] - axis[0])
    low, high = axis[inside.min(axis=0)] - 0.005, axis[inside.max(axis=0)] + 0.005
    step = float((high - low).max()) / cells
    axes = [np.arange(a, b + step, step) for a, b in zip(low, high, strict=True)]
    field = SCANS[kind](np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    wp.config.quiet = True
    found = wp.MarchingCubes.extract_surface_marching_cubes(wp.array(field, dtype=float, device="cpu"), 0.0)
    points, triangles = (each.numpy() for each in found)
    mesh = trimesh.Trimesh(points.astype(float) * step + low, triangles.reshape(-1, 3)[:, ::-1])
    if mesh.volume < 0.0:
        mesh.invert()
    mesh.vertices = mesh.vertices + random.normal(0.0, noise, (len(mesh.vertices), 1)) * mesh.vertex_normals
    underside = mesh.vertices[mesh.vertices[:, 2] < np.quantile(mesh.vertices[:, 2], 0.1)]
    gone = np.zeros(len(mesh.faces), dtype=bool)
    for place in underside[random.integers(len(underside), size=holes)]:
        gone |= np.linalg.norm(mesh.triangles_center - place, axis=1) < 0.005
    mesh.update_faces(~gone)
    mesh.remove_unreferenced_vertices()
    return mesh
