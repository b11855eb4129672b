"""Lays a mesh on the table in a stable pose."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import shapely
import trimesh
from shapely.geometry import MultiPoint
from trimesh.poses import compute_stable_poses

from oimppi_warp.authoring.meshes.moments import moments
from oimppi_warp.authoring.prims import z_to
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import rotation_matrix

Lay = Literal["stable", "as-is"]

_ALIKE = 0.9  # poses with at least this share of the best one's probability count as equally good


def lay_on_table(mesh: trimesh.Trimesh, how: Lay, file: Path) -> str:
    """Turns a mesh into its pose on the table, and centres it: centre of mass on the z axis, origin at half its height.

    The most stable pose is the one in which it would most often come to rest if dropped (trimesh, after Goldberg et
    al., 1999); among similar poses, the one that needs the smallest rotation is chosen. Long sides are aligned with the
    axes.

    Args:
        mesh: A closed surface [m]; it is moved.
        how: ``"stable"`` for its most stable pose, ``"as-is"`` to keep its z axis up, as it was modelled.
        file: Source file, for error messages.

    Returns:
        A description of the operation.

    Raises:
        SceneError: The mesh cannot rest in this pose.
    """
    done = "placed as it was modelled"
    if how == "stable":
        probability, turn = _most_stable(mesh)
        mesh.apply_transform(turn)
        mesh.apply_transform(_along_axes(mesh))
        tilt = np.degrees(np.arccos(np.clip(turn[2, 2], -1.0, 1.0)))
        done = f"placed in its most stable pose ({100 * probability:.0f} % of drops)"
        done += f", tilted by {tilt:.0f} degrees" if tilt > 1.0 else ", as it was modelled"
    elif not _is_stable(mesh):
        raise SceneError(
            "the object would fall over in this pose: its centre of mass is not above its support area",
            file=file,
            allowed="a pose in which it can stand",
            fix="lay it in its most stable pose (--lay stable), or rotate it in your modelling program",
        )
    (low, high), center = mesh.bounds, moments(mesh).center
    mesh.apply_translation([-center[0], -center[1], -(low[2] + high[2]) / 2])
    return done


def _most_stable(mesh: trimesh.Trimesh) -> tuple[float, np.ndarray]:
    """Returns the probability of the likeliest resting pose, and the smallest rotation that produces it [4, 4]."""
    poses, probabilities = compute_stable_poses(mesh, center_mass=moments(mesh).center, threshold=0.01)
    alike = [
        (pose[2, :3], probability)
        for pose, probability in zip(poses, probabilities, strict=True)
        if probability > _ALIKE * probabilities[0]
    ]
    up, probability = max(alike, key=lambda each: round(each[0][2], 3))
    turn = np.eye(4)
    turn[:3, :3] = rotation_matrix(z_to(up)).T
    return float(probability), turn


def _along_axes(mesh: trimesh.Trimesh) -> np.ndarray:
    """Returns the smallest rotation about z that aligns the mesh's tightest bounding rectangle with the axes [4, 4]."""
    rectangle = MultiPoint(mesh.vertices[:, :2]).minimum_rotated_rectangle
    a, b = np.asarray(shapely.get_coordinates(rectangle))[:2]
    angle = np.arctan2(b[1] - a[1], b[0] - a[0])
    return trimesh.transformations.rotation_matrix(-(angle - np.pi / 2 * np.round(angle / (np.pi / 2))), [0, 0, 1])


def _is_stable(mesh: trimesh.Trimesh) -> bool:
    """Returns whether the centre of mass lies above the hull of the points that touch the table."""
    low = mesh.vertices[mesh.vertices[:, 2] < mesh.bounds[0, 2] + 1e-4]
    hull = MultiPoint(low[:, :2]).convex_hull
    return hull.geom_type == "Polygon" and bool(shapely.contains_xy(hull, *moments(mesh).center[:2]))
