"""Flat objects made of convex pieces of equal height: boxes, discs and prisms, drawn in the plane of the table.

An object's frame lies at half its height; in the plane it is the frame in which tasks give its poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from pxr import Usd, UsdGeom

from oimppi_warp.authoring.prims import (
    Color,
    Look,
    bind_physics,
    box,
    cylinder,
    mass_properties,
    new_stage,
    physics_material,
    prism,
)

Point = tuple[float, float]


@dataclass(frozen=True)
class Box:
    """A rectangle: centre and side lengths (x, y) [m]."""

    center: Point
    size: Point

    def polygon(self) -> np.ndarray:
        """Returns the corners, counter-clockwise, shape [4, 2] [m]."""
        half = np.array(self.size) / 2
        return np.array(self.center) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


@dataclass(frozen=True)
class Disc:
    """A disc centred at the object's origin [m]."""

    radius: float


class Pushable(Protocol):
    """An object that a task can be written with; it has its own file.

    Attributes:
        name: Name of the object's file.
        doc: Description.
        friction: Coulomb coefficient with the table; ``None``: the table's own value is used.
        color: Display colour.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def doc(self) -> str: ...  # noqa: D102
    @property
    def friction(self) -> float | None: ...  # noqa: D102
    @property
    def color(self) -> Color: ...  # noqa: D102
    @property
    def rest_height(self) -> float:
        """Returns the height of the object's frame when it lies on the table [m]."""
        ...

    @property
    def yaw_matters(self) -> bool:
        """Returns whether the object's yaw can be told from its shape (not for a disc)."""
        ...

    def draw(self, stage: Usd.Stage, root: str, look: Look) -> None:
        """Writes the object's shape below the prim ``root`` of a stage, with the colour and opacity of ``look``."""

    def write(self, file: Path, *, note: str = "") -> None:
        """Writes the object's file, with ``note`` appended to its documentation."""


@dataclass(frozen=True)
class FlatObject:
    """A flat object: convex pieces of equal height that do not overlap.

    Attributes:
        name: Name of the object's file.
        prim: Name of the object's prim.
        doc: Description.
        pieces: Each a box, a disc, or a convex polygon (counter-clockwise, [n, 2]).
        height: Height [m].
        mass: Mass [kg].
        friction: Coulomb coefficient with the table.
        color: Linear RGB.
    """

    name: str
    prim: str
    doc: str
    pieces: tuple[Box | Disc | np.ndarray, ...]
    height: float
    mass: float
    friction: float
    color: Color

    @property
    def rest_height(self) -> float:
        """Returns the height of the object's frame when it lies on the table [m]."""
        return self.height / 2

    @property
    def yaw_matters(self) -> bool:
        """Returns whether the object's yaw is visible; that of a disc is not."""
        return not all(isinstance(piece, Disc) for piece in self.pieces)

    def draw(self, stage: Usd.Stage, root: str, look: Look) -> None:
        """Writes the pieces below the prim ``root`` of a stage, with the colour and opacity of ``look``."""
        for number, piece in enumerate(self.pieces):
            path = f"{root}/piece{number}"
            if isinstance(piece, Box):
                box(stage, path, (*piece.center, 0.0), (*piece.size, self.height), look)
            elif isinstance(piece, Disc):
                cylinder(stage, path, (0.0, 0.0, 0.0), piece.radius, self.height, look)
            else:
                prism(stage, path, piece, self.height, look)

    def write(self, file: Path, *, note: str = "") -> None:
        """Writes the object's file, with ``note`` appended to its documentation."""
        stage = new_stage(file, self.prim, ". ".join(filter(None, (self.doc, note))))
        root = stage.GetDefaultPrim()
        material = physics_material(stage, f"/{self.prim}/Material", self.friction)
        UsdGeom.Scope.Define(stage, f"/{self.prim}/shape")
        self.draw(stage, f"/{self.prim}/shape", Look(self.color, collide=True))
        bind_physics(root, material)
        mass_properties(root, self.mass, *self.center_and_inertia())
        stage.Save()

    def center_and_inertia(self) -> tuple[tuple[float, float, float], np.ndarray]:
        """Returns the centre of mass [m] and the inertia about it [kg m^2] at uniform density."""
        parts = [_moments(piece) for piece in self.pieces]
        area = sum(part[0] for part in parts)
        first = np.sum([part[1] for part in parts], axis=0) / area
        second = np.sum([part[2] for part in parts], axis=0) / area - np.outer(first, first)
        spin, up = second[0, 0] + second[1, 1], self.height**2 / 12
        inertia = np.array([[second[1, 1] + up, -second[0, 1], 0], [-second[0, 1], second[0, 0] + up, 0], [0, 0, spin]])
        return (first[0], first[1], 0.0), self.mass * inertia


def _moments(piece: Box | Disc | np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Returns area, first and second moments about the origin."""
    if isinstance(piece, Disc):
        area = np.pi * piece.radius**2
        return area, np.zeros(2), area * piece.radius**2 / 4 * np.eye(2)
    a = piece.polygon() if isinstance(piece, Box) else piece
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    first = ((a + b) * cross[:, None]).sum(axis=0) / 6
    second = np.einsum("n,ni,nj->ij", cross, a, a) + np.einsum("n,ni,nj->ij", cross, b, b)
    mixed = np.einsum("n,ni,nj->ij", cross, a, b)
    return cross.sum() / 2, first, (2 * second + mixed + mixed.T) / 24


def stroke(points: list[Point], width: float, chamfer: float, closed: bool = False) -> list[np.ndarray]:
    """Traces a line with a broad pen: one convex piece per segment, mitred at the bends, with outer corners cut off.

    Args:
        points: The pen's path [m].
        width: Width of the pen [m].
        chamfer: Length cut off along either side of an outer corner [m].
        closed: Whether the last point is joined to the first.
    """
    p = np.array(points)
    n = len(p)
    along = np.roll(p, -1, axis=0) - p
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.c_[-along[:, 1], along[:, 0]]
    pieces = []
    for i in range(n if closed else n - 1):
        j = (i + 1) % n
        bend_start = closed or i > 0
        bend_end = closed or j < n - 1
        right_side, left_side = [], []
        for corner, bend, d_in, d_out in ((i, bend_start, i - 1, i), (j, bend_end, i, j)):
            at_start = corner == i
            if not bend:
                right_side.append(p[corner] - left[i] * width / 2)
                left_side.append(p[corner] + left[i] * width / 2)
                continue
            turn = along[d_in][0] * along[d_out][1] - along[d_in][1] * along[d_out][0]
            mitre = (left[d_in] + left[d_out]) / (1.0 + left[d_in] @ left[d_out]) * width / 2
            inside = mitre if turn > 0 else -mitre
            outer, inner = p[corner] - inside, p[corner] + inside
            middle = outer + chamfer * (along[d_out] - along[d_in]) / 2
            edge = outer + chamfer * along[d_out] if at_start else outer - chamfer * along[d_in]
            outer_points = [middle, edge] if at_start else [edge, middle]
            (right_side if turn > 0 else left_side).extend(outer_points)
            (left_side if turn > 0 else right_side).append(inner)
        pieces.append(np.round(np.array(right_side + left_side[::-1]), 6))
    return pieces
