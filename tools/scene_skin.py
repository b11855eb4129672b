"""Display geometry of arms, mainly the xArm6: drums at the joints, and swept tubes between them.

The shapes are original, modelled after the outer dimensions of the vendor's arm (link frames, metres).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from oimppi_warp.authoring.prims import Color, Look, Points, Vector, box, mesh, new_stage

SHELL, DARK, METAL = (0.82, 0.83, 0.84), (0.05, 0.055, 0.06), (0.4, 0.41, 0.43)

SEGMENTS = 24
FILLET = 0.006

Rings = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Centres [n, 3], radii [n] and axes [n, 3] of the circles that span a surface."""

Part = tuple[str, Rings, Color]
"""A surface: its name, its circles and its colour."""


def drum(start: Vector, end: Vector, radius: float, end_radius: float | None = None, fillet: float = FILLET) -> Rings:
    """Create a cylinder, or a cone, with rounded edges."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    length, axis = float(np.linalg.norm(b - a)), (b - a) / np.linalg.norm(b - a)
    angle = np.linspace(0.0, np.pi / 2, 3)
    top = radius if end_radius is None else end_radius
    along = np.concatenate([fillet * (1 - np.cos(angle)), length - fillet * (1 - np.cos(angle[::-1]))])
    radii = np.concatenate([radius - fillet * (1 - np.sin(angle)), top - fillet * (1 - np.sin(angle[::-1]))])
    return a + along[:, None] * axis, radii, np.tile(axis, (len(along), 1))


def sweep(points: Points, radii: Vector, count: int = 14) -> Rings:
    """Create a tube along a smooth curve through points (a Catmull-Rom spline), with a radius at each point."""
    p = np.c_[np.asarray(points, float), np.asarray(radii, float)]
    p = np.vstack([2 * p[0] - p[1], p, 2 * p[-1] - p[-2]])
    u = np.linspace(0.0, len(p) - 3 - 1e-9, count)
    i, t = u.astype(int), (u % 1.0)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    line = b + t / 2 * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)))
    slope = np.gradient(line[:, :3], axis=0)
    return line[:, :3], line[:, 3], slope / np.linalg.norm(slope, axis=1, keepdims=True)


def stretch(stage: Usd.Stage, path: str, rings: Rings, color: Color) -> None:
    """Write the closed, smooth surface through a sequence of circles."""
    centers, radii, axes = rings
    side = np.cross(axes[0], np.eye(3)[np.abs(axes[0]).argmin()])
    angle = np.linspace(0.0, 2 * np.pi, SEGMENTS, endpoint=False)[:, None]
    points = []
    for center, radius, axis in zip(centers, radii, axes, strict=True):
        side = side - (side @ axis) * axis  # transported along the line without twist
        side /= np.linalg.norm(side)
        points.append(center + radius * (np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)))
    n, rows = SEGMENTS, len(centers)
    around = [(j, (j + 1) % n) for j in range(n)]
    quads = [[r * n + j, r * n + k, (r + 1) * n + k, (r + 1) * n + j] for r in range(rows - 1) for j, k in around]
    first, last = rows * n, rows * n + 1
    caps = [[first, k, j] for j, k in around] + [[last, (rows - 1) * n + j, (rows - 1) * n + k] for j, k in around]
    vertices = np.vstack([*points, centers[0], centers[-1]])
    mesh(stage, path, vertices, quads + caps, Look(color), _normals(vertices, quads + caps))


def _normals(vertices: np.ndarray, faces: list[list[int]]) -> np.ndarray:
    """Returns unit vertex normals, averaging the adjacent faces weighted by area."""
    normals = np.zeros_like(vertices)
    for face in faces:
        corners = vertices[face]
        normals[face] += np.cross(corners[1] - corners[0], corners[-1] - corners[0]) + np.cross(
            corners[-1] - corners[-2], corners[1] - corners[-2]
        )
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _y(x: float, y0: float, y1: float, radius: float) -> Rings:
    return drum((x, y0, 0.0), (x, y1, 0.0), radius)


def _z(z0: float, z1: float, radius: float, x: float = 0.0, y: float = 0.0) -> Rings:
    return drum((x, y, z0), (x, y, z1), radius)


_PARTS: dict[str, list[Part]] = {
    "base": [
        ("plate", drum((0, 0, 0), (0, 0, 0.01), 0.09, fillet=0.002), METAL),
        ("column", drum((0, 0, 0.01), (0, 0, 0.148), 0.063, 0.0485), SHELL),
        ("collar", drum((0, 0, 0.1465), (0, 0, 0.1565), 0.0465, fillet=0.001), DARK),
    ],
    "link1": [
        ("column", _z(-0.112, 0.0, 0.0478), SHELL),
        ("drum", _y(0.0, -0.05, 0.072, 0.048), SHELL),
        ("cap", _y(0.0, -0.057, -0.049, 0.043), DARK),
        ("collar", drum((0, 0.0705, 0), (0, 0.0765, 0), 0.0455, fillet=0.001), DARK),
    ],
    "link2": [
        ("shoulder", _z(0.075, 0.112, 0.0475), SHELL),
        ("cap", _z(0.111, 0.119, 0.042), DARK),
        (
            "arm",
            sweep(
                [
                    (0, 0.0, 0.0935),
                    (0, -0.06, 0.09),
                    (0, -0.112, 0.05),
                    (0, -0.15, 0.006),
                    (0, -0.2, 0),
                    (0.004, -0.255, 0),
                ],
                [0.036, 0.039, 0.043, 0.044, 0.044, 0.043],
            ),
            SHELL,
        ),
        ("bend", sweep([(0.002, -0.235, 0), (0.022, -0.27, 0), (0.05, -0.2845, 0)], [0.043, 0.0425, 0.042], 7), SHELL),
        ("elbow", _z(-0.062, 0.064, 0.043, 0.0535, -0.2845), SHELL),
        ("back", _z(-0.069, -0.061, 0.038, 0.0535, -0.2845), DARK),
        ("collar", drum((0.0535, -0.2845, 0.0625), (0.0535, -0.2845, 0.0685), 0.041, fillet=0.001), DARK),
    ],
    "link3": [
        ("elbow", _z(0.067, 0.1, 0.042), SHELL),
        ("cap", _z(0.099, 0.107, 0.037), DARK),
        (
            "arm",
            sweep(
                [
                    (0, 0, 0.0845),
                    (0.035, 0.042, 0.088),
                    (0.066, 0.074, 0.066),
                    (0.0775, 0.098, 0.02),
                    (0.0775, 0.13, 0),
                    (0.0775, 0.16, 0),
                ],
                [0.032, 0.034, 0.038, 0.0415, 0.0423, 0.0423],
            ),
            SHELL,
        ),
        ("collar", drum((0.0775, 0.159, 0), (0.0775, 0.1705, 0), 0.0405, fillet=0.001), DARK),
    ],
    "link4": [
        ("drum", _z(-0.172, -0.128, 0.0425), SHELL),
        (
            "arm",
            sweep(
                [(0, 0.0, -0.15), (0, 0.03, -0.128), (0, 0.055, -0.095), (0, 0.062, -0.05), (0, 0.052, 0.0)],
                [0.038, 0.032, 0.028, 0.029, 0.033],
            ),
            SHELL,
        ),
        ("wrist", _y(0.0, 0.008, 0.079, 0.0382), SHELL),
        ("cap", _y(0.0, 0.078, 0.086, 0.034), DARK),
        ("collar", drum((0, 0.003, 0), (0, 0.009, 0), 0.036, fillet=0.001), DARK),
    ],
    "link5": [
        ("drum", _z(-0.003, 0.051, 0.0375), SHELL),
        ("cap", _z(0.05, 0.058, 0.033), DARK),
        ("arm", sweep([(0.0, 0.0, 0.022), (0.04, 0.002, 0.019), (0.07, 0.015, 0.004)], [0.03, 0.028, 0.03], 8), SHELL),
        ("wrist", _y(0.076, -0.029, 0.066, 0.0375), SHELL),
        ("back", _y(0.076, -0.035, -0.028, 0.033), DARK),
        ("collar", drum((0.076, 0.0645, 0), (0.076, 0.0705, 0), 0.0355, fillet=0.001), DARK),
    ],
    "link6": [
        ("flange", drum((0, 0, -0.0275), (0, 0, -0.006), 0.0374, fillet=0.003), SHELL),
        ("face", drum((0, 0, -0.007), (0, 0, 0), 0.0315, fillet=0.001), METAL),
        ("plug", drum((0, -0.03, -0.0165), (0, -0.052, -0.0165), 0.009, fillet=0.002), DARK),
    ],
}


def write(file: Path, tool_length: float, tool_radius: float) -> None:
    """Write the xArm6's display geometry as a separate layer, which keeps the robot's file short enough to read."""
    stage = write_parts(file, "XArm6", "the xArm6", _PARTS, tool_length, tool_radius)
    connector = (-0.0685, 0.0, 0.05), (0.043, 0.062, 0.066)
    box(stage, "/XArm6/base/skin/connector", *connector, Look(SHELL))
    stage.Save()


def write_parts(
    file: Path, root: str, noun: str, parts: Mapping[str, Sequence[Part]], tool_length: float, tool_radius: float
) -> Usd.Stage:
    """Write the parts of each link of an arm, and its stick, and return the stage, which the caller must save."""
    stage = new_stage(file, root, f"Looks of {noun}. Written by tools/make_scenes.py; do not edit by hand.")
    for link, drawn in parts.items():
        UsdGeom.Scope.Define(stage, f"/{root}/{link}/skin")
        for name, rings, color in drawn:
            stretch(stage, f"/{root}/{link}/skin/{name}", rings, color)
    stick = drum((0, 0, 0.015), (0, 0, tool_length), tool_radius, fillet=tool_radius * 0.999)
    UsdGeom.Scope.Define(stage, f"/{root}/tool/skin")
    stretch(stage, f"/{root}/tool/skin/socket", drum((0, 0, 0), (0, 0, 0.022), 0.024, 0.014, 0.003), DARK)
    stretch(stage, f"/{root}/tool/skin/stick", stick, METAL)
    return stage
