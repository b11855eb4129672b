"""Lays a mesh on the table in a stable pose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import shapely
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from shapely.geometry import MultiPoint
from trimesh.poses import compute_stable_poses

from oimppi_warp.authoring.meshes.hulls import limited_hull
from oimppi_warp.authoring.meshes.moments import moments
from oimppi_warp.authoring.prims import z_to
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import rotation_matrix
from oimppi_warp.geometry.rolling import Rolling, rolling_of_points

Lay = Literal["stable", "flat", "as-is"]

_ALIKE = 0.9  # poses with at least this share of the best one's probability count as equally good
_ROLLING_ANGLE, _ROLLING_HEIGHT = np.radians(31.0), 0.03
"""Two resting poses are one, on a round side, if the object is turned by less and lifted by less from one to the other:
angle [rad], and relative change of the centre of mass's height."""
_INSIDE = 1e-4  # least depth of the centre of mass within the hull [m]
_HULL_FACES = 400  # a hull of more faces is simplified to find the poses


@dataclass(frozen=True)
class Rest:
    """A way in which a mesh comes to rest.

    Attributes:
        up: Direction in the mesh that then points up, shape [3].
        probability: Share of random drops that end so; those on neighbouring faces of a round side are added up.
        rolls: How the mesh then rolls.
    """

    up: np.ndarray
    probability: float
    rolls: Rolling


def lay_on_table(
    mesh: trimesh.Trimesh, how: Lay, file: Path, *, center: np.ndarray | None = None
) -> tuple[np.ndarray, str]:
    """Turns a mesh into its pose on the table, and centres it: centre of mass on the z axis, origin at half its height.

    The most stable pose is the one in which it would most often come to rest if dropped (trimesh, after Goldberg et
    al., 1999); among similar poses, the one that needs the smallest rotation is chosen. Long sides are aligned with the
    axes.

    Args:
        mesh: A closed surface [m]; it is moved.
        how: ``"stable"`` for its most stable pose, ``"flat"`` for its most stable one in which it does not roll,
            ``"as-is"`` to keep its z axis up, as it was modelled.
        file: Source file, for error messages.
        center: Centre of mass, shape [3] [m]; ``None``: that of the mesh at uniform density.

    Returns:
        The motion, shape [4, 4], and a description of it.

    Raises:
        SceneError: The mesh cannot rest in this pose.
    """
    done, motion = "placed as it was modelled", np.eye(4)
    center = moments(mesh).center if center is None else center
    if how == "as-is":
        if not _is_stable(mesh, center):
            raise SceneError(
                "the object would fall over in this pose: its centre of mass is not above its support area",
                file=file,
                allowed="a pose in which it can stand",
                fix="lay it in its most stable pose (--lay stable), or rotate it in your modelling program",
            )
    else:
        rests = resting_poses(mesh, center)
        if how == "flat":
            rests = [rest for rest in rests if not rest.rolls]
        if not rests and how == "stable":
            raise SceneError(
                "the object has no pose of rest: its centre of mass is not within its convex hull",
                file=file,
                allowed="a centre of mass inside the object",
                fix="correct the centre of mass, or the size of the shapes",
            )
        if not rests:
            raise SceneError(
                "the object has no flat side to rest on",
                file=file,
                allowed="a pose in which it does not roll",
                fix="use --lay stable: it then rolls when it is pushed, which the planner does not predict",
            )
        rest = _best(rests)
        turn = np.eye(4)
        turn[:3, :3] = rotation_matrix(z_to(rest.up)).T
        mesh.apply_transform(turn)
        straight = _along_axes(mesh)
        mesh.apply_transform(straight)
        motion = straight @ turn
        tilt = np.degrees(np.arccos(np.clip(turn[2, 2], -1.0, 1.0)))
        which = "most stable pose" if how == "stable" else "most stable pose on a flat side"
        done = f"placed in its {which} ({100 * rest.probability:.0f} % of drops)"
        done += f", tilted by {tilt:.0f} degrees" if tilt > 1.0 else ", as it was modelled"
    (low, high), (x, y, _) = mesh.bounds, motion[:3, :3] @ center
    move = np.eye(4)
    move[:3, 3] = -x, -y, -(low[2] + high[2]) / 2
    mesh.apply_transform(move)
    return move @ motion, done


def resting_poses(mesh: trimesh.Trimesh, center: np.ndarray) -> list[Rest]:
    """Returns the ways in which a mesh comes to rest, the likeliest first.

    A round side is one of them, however many faces it is made of.

    Args:
        mesh: A closed surface [m].
        center: Its centre of mass, shape [3] [m]; there is no resting pose if it is not inside the convex hull.
    """
    hull = mesh.convex_hull
    if depth_within(hull, center) < _INSIDE:
        return []
    coarse = hull
    if len(hull.faces) > _HULL_FACES:
        corners, faces = limited_hull(hull.vertices, _HULL_FACES // 2)
        coarse = trimesh.Trimesh(corners, faces)
    poses, probabilities = compute_stable_poses(coarse, center_mass=center, threshold=0.0)
    if not len(poses):
        return []
    ups, points = poses[:, 2, :3], hull.vertices - center
    heights = -(points @ ups.T).min(axis=0)
    near = np.arccos(np.clip(ups @ ups.T, -1.0, 1.0)) < _ROLLING_ANGLE
    near &= np.abs(heights[:, None] - heights) < _ROLLING_HEIGHT * heights
    number, labels = connected_components(coo_matrix(near | near.T), directed=False)
    found = []
    for each in range(number):
        members = np.flatnonzero(labels == each)
        likely = members[probabilities[members] > _ALIKE * probabilities[members].max()]
        up = ups[likely[np.argmax(np.round(ups[likely, 2], 3))]]
        if coarse is not hull:
            up = _true_face(hull, center, up)
        turned = points @ rotation_matrix(z_to(up))
        found.append(Rest(up, float(probabilities[members].sum()), rolling_of_points(turned)))
    return sorted(found, key=lambda rest: -rest.probability)


def depth_within(hull: trimesh.Trimesh, point: np.ndarray) -> float:
    """Returns the depth of a point [3] within a convex hull [m]; negative outside."""
    return float(np.einsum("fi,fi->f", hull.triangles[:, 0] - point, hull.face_normals).min())


def _best(rests: list[Rest]) -> Rest:
    """Returns the likeliest of resting poses or, among similar ones, the one that needs the smallest rotation."""
    alike = [rest for rest in rests if rest.probability > _ALIKE * rests[0].probability]
    return max(alike, key=lambda rest: round(float(rest.up[2]), 3))


def _true_face(hull: trimesh.Trimesh, center: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Returns the direction that points up when a hull rests on the face, of those it can rest on, nearest to a pose.

    A hull can rest on a face if its centre of mass is above it.
    """
    normals = hull.face_normals
    depth = np.einsum("fi,fi->f", hull.triangles[:, 0] - center, normals)
    below = center + depth[:, None] * normals
    inside = (trimesh.triangles.points_to_barycentric(hull.triangles, below) > -1e-6).all(axis=1)
    turned = np.where(inside, normals @ -up, -np.inf)
    return -normals[turned.argmax()] if inside.any() else up


def _along_axes(mesh: trimesh.Trimesh) -> np.ndarray:
    """Returns the smallest rotation about z that aligns the mesh's tightest bounding rectangle with the axes [4, 4]."""
    rectangle = MultiPoint(mesh.vertices[:, :2]).minimum_rotated_rectangle
    a, b = np.asarray(shapely.get_coordinates(rectangle))[:2]
    angle = np.arctan2(b[1] - a[1], b[0] - a[0])
    return trimesh.transformations.rotation_matrix(-(angle - np.pi / 2 * np.round(angle / (np.pi / 2))), [0, 0, 1])


def _is_stable(mesh: trimesh.Trimesh, center: np.ndarray) -> bool:
    """Returns whether the centre of mass lies above the hull of the points that touch the table."""
    low = mesh.vertices[mesh.vertices[:, 2] < mesh.bounds[0, 2] + 1e-4]
    hull = MultiPoint(low[:, :2]).convex_hull
    return hull.geom_type == "Polygon" and bool(shapely.contains_xy(hull, *center[:2]))
