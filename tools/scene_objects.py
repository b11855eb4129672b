"""The things that are pushed and the things in the way, each drawn as boxes, prisms and cylinders on the table.

The frame of an object lies at half its height; in the plane it is the one that the tasks give their poses in.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom
from scene_prims import (
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
        """Its corners, counter-clockwise."""
        half = np.array(self.size) / 2
        return np.array(self.center) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


@dataclass(frozen=True)
class Disc:
    """A disc about the object's origin [m]."""

    radius: float


@dataclass(frozen=True)
class Thing:
    """A flat object: convex pieces that do not overlap, all of one height.

    Attributes:
        name: Name of its file.
        prim: Name of its prim.
        doc: What it is.
        pieces: A box, a disc, or a convex polygon (counter-clockwise, [n, 2]) each.
        height: [m].
        mass: [kg].
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

    def draw(self, stage: Usd.Stage, root: str, look: Look) -> None:
        """Write the pieces below ``root``."""
        for number, piece in enumerate(self.pieces):
            path = f"{root}/piece{number}"
            if isinstance(piece, Box):
                box(stage, path, (*piece.center, 0.0), (*piece.size, self.height), look)
            elif isinstance(piece, Disc):
                cylinder(stage, path, (0.0, 0.0, 0.0), piece.radius, self.height, look)
            else:
                prism(stage, path, piece, self.height, look)

    def write(self, file: Path) -> None:
        """Write the object's file."""
        stage = new_stage(file, self.prim, f"{self.doc}. Written by tools/make_scenes.py; do not edit by hand.")
        root = stage.GetDefaultPrim()
        material = physics_material(stage, f"/{self.prim}/Material", self.friction)
        UsdGeom.Scope.Define(stage, f"/{self.prim}/shape")
        self.draw(stage, f"/{self.prim}/shape", Look(self.color, collide=True))
        bind_physics(root, material)
        mass_properties(root, self.mass, *self.center_and_inertia())
        stage.Save()

    def center_and_inertia(self) -> tuple[tuple[float, float, float], np.ndarray]:
        """Centre of mass [m] and inertia about it [kg m^2] at uniform density."""
        parts = [_moments(piece) for piece in self.pieces]
        area = sum(part[0] for part in parts)
        first = np.sum([part[1] for part in parts], axis=0) / area
        second = np.sum([part[2] for part in parts], axis=0) / area - np.outer(first, first)
        spin, up = second[0, 0] + second[1, 1], self.height**2 / 12
        inertia = np.array([[second[1, 1] + up, -second[0, 1], 0], [-second[0, 1], second[0, 0] + up, 0], [0, 0, spin]])
        return (first[0], first[1], 0.0), self.mass * inertia


def _moments(piece: Box | Disc | np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Area, first and second moments about the origin."""
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
    """A line drawn with a broad pen: one convex piece a segment, mitred at the bends, their outer corners cut off.

    Args:
        points: The pen's way [m].
        width: Of the pen [m].
        chamfer: How much is cut off along either side of an outer corner [m].
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


PEN = 0.022
WOOD, BLUE, RED, GREEN = (0.72, 0.45, 0.2), (0.1, 0.22, 0.55), (0.62, 0.09, 0.08), (0.12, 0.42, 0.2)
LETTER = 0.103  # cap height
TOP = LETTER / 2 - PEN / 2
SIDE = 0.042 - PEN / 2

T_BLOCK = Thing(
    "t_block",
    "TBlock",
    "T block: bar 0.20 x 0.05 x 0.05 m, stem 0.05 x 0.10 x 0.05 m; the frame is at the bar's centre",
    (Box((0.0, 0.0), (0.20, 0.05)), Box((0.0, -0.075), (0.05, 0.10))),
    0.05,
    0.5,
    0.4,
    (0.16, 0.36, 0.62),
)
LAB_T = Thing(
    "lab_t",
    "LabT",
    "The laboratory's small T: bar 0.089 x 0.0198 m, stem 0.0198 x 0.0794 m, 0.060 m high; frame at the bar's centre",
    (Box((0.0, 0.0), (0.089, 0.0198)), Box((0.0, -0.0496), (0.0198, 0.0794))),
    0.060,
    0.1,
    0.3,
    WOOD,
)
SOUP_CAN = Thing(
    "soup_can",
    "SoupCan",
    "Tomato soup can, the size and weight of YCB object 005",
    (Disc(0.033),),
    0.101,
    0.349,
    0.4,
    RED,
)
LETTER_I = Thing("letter_i", "LetterI", "The letter I", (Box((0.0, 0.0), (0.03, LETTER)),), 0.05, 0.1, 0.4, BLUE)
LETTER_S = Thing(
    "letter_s",
    "LetterS",
    "The letter S",
    tuple(stroke([(SIDE, TOP), (-SIDE, TOP), (-SIDE, 0), (SIDE, 0), (SIDE, -TOP), (-SIDE, -TOP)], PEN, 0.012)),
    0.05,
    0.2,
    0.4,
    GREEN,
)
LETTER_O = Thing(
    "letter_o",
    "LetterO",
    "The letter O",
    tuple(stroke([(SIDE, TOP), (-SIDE, TOP), (-SIDE, -TOP), (SIDE, -TOP)], PEN, 0.018, closed=True)),
    0.05,
    0.2,
    0.4,
    BLUE,
)
_BELLY = -0.008  # height of the middle of the R's lower bar
_STEM, _RIGHT = -SIDE, SIDE
LETTER_R = Thing(
    "letter_r",
    "LetterR",
    "The letter R",
    (
        Box((_STEM, 0.0), (PEN, LETTER)),
        *stroke([(_STEM + PEN / 2, _BELLY), (_RIGHT, _BELLY), (_RIGHT, TOP), (_STEM + PEN / 2, TOP)], PEN, 0.012),
        np.array([(0.018, -LETTER / 2), (0.044, -LETTER / 2), (0.018, _BELLY - PEN / 2), (-0.008, _BELLY - PEN / 2)]),
    ),
    0.05,
    0.2,
    0.4,
    BLUE,
)
THINGS = (T_BLOCK, LAB_T, SOUP_CAN, LETTER_I, LETTER_R, LETTER_O, LETTER_S)
