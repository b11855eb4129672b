"""Objects of simple shape: boxes, cylinders, prisms, and extrusions of any flat outline."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from oimppi_warp.authoring.objects.flat_object import Box, Disc, FlatObject
from oimppi_warp.authoring.objects.polygons import convex_pieces
from oimppi_warp.authoring.prims import Color
from oimppi_warp.errors import ConfigError, SceneError

DENSITY = 650.0
"""Density of an object whose mass is not given [kg/m^3]: that of the shipped objects, which are of wood."""

FRICTION = 0.4
"""Default Coulomb coefficient of an object with the table."""

TABLE_FRICTION = 0.1
"""Coulomb coefficient of a new scene's table [-]; it counts for an object without a material."""

SIZES = (0.03, 0.5)
"""Range of the longest side of an object from a file [m]: the stick is 0.016 m wide, the arm reaches 0.7 m."""

LOWEST = 0.008
"""Minimum height of an object [m]: the tip of the stick is round and must touch the object's side."""

SIDES = (0.01, 0.6)
"""Smallest and largest side length of an object [m]."""

SIDES_OF_PRISM = (3, 24)
"""Smallest and largest number of sides of a prism; use a cylinder for a rounder shape."""

WOOD: Color = (0.72, 0.45, 0.2)


def box(
    length: float, width: float, height: float, *, mass: float | None = None, friction: float = FRICTION
) -> FlatObject:
    """Creates a box.

    Args:
        length, width, height: Side lengths along x, y and z [m].
        mass: Mass [kg]; ``None``: computed from the density of wood.
        friction: Coulomb coefficient with the table.

    Raises:
        ConfigError: A length, the mass or the friction is invalid.
    """
    sides = checked_sides("box", length, width, height)
    doc = f"A box of {length:g} x {width:g} x {height:g} m"
    weight = checked_mass(mass, math.prod(sides))
    pieces = (Box((0.0, 0.0), (length, width)),)
    return FlatObject(_named("box", sides), "Box", doc, pieces, height, weight, checked_friction(friction), WOOD)


def cylinder(radius: float, height: float, *, mass: float | None = None, friction: float = FRICTION) -> FlatObject:
    """Creates an upright cylinder.

    Args:
        radius, height: Its dimensions [m].
        mass: Mass [kg]; ``None``: computed from the density of wood.
        friction: Coulomb coefficient with the table.

    Raises:
        ConfigError: A length, the mass or the friction is invalid.
    """
    checked_sides("cylinder", 2.0 * radius, height)
    doc = f"A cylinder of {radius:g} m radius, {height:g} m high"
    weight = checked_mass(mass, math.pi * radius**2 * height)
    name = _named("cylinder", (radius, height))
    return FlatObject(name, "Cylinder", doc, (Disc(radius),), height, weight, checked_friction(friction), WOOD)


def regular_prism(
    sides: float, radius: float, height: float, *, mass: float | None = None, friction: float = FRICTION
) -> FlatObject:
    """Creates an upright prism over a regular polygon, with one of its sides facing -y in the object's frame.

    Args:
        sides: Number of the polygon's sides, an integer from 3 to 24 (:data:`SIDES_OF_PRISM`).
        radius: Distance from the polygon's centre to its corners [m].
        height: Height [m].
        mass: Mass [kg]; ``None``: computed from the density of wood.
        friction: Coulomb coefficient with the table.

    Raises:
        ConfigError: The number of sides, a length, the mass or the friction is invalid.
    """
    if sides not in range(SIDES_OF_PRISM[0], SIDES_OF_PRISM[1] + 1):
        few, many = SIDES_OF_PRISM
        raise ConfigError(
            f"prism: {sides:g} is not a valid number of sides\n  allowed: an integer from {few} to {many}"
        )
    count = int(sides)
    angles = math.tau * (np.arange(count) + 0.5) / count - math.pi / 2
    outline = Polygon(radius * np.column_stack([np.cos(angles), np.sin(angles)]))
    doc = f"A prism of {count} sides, {radius:g} m from centre to corner, {height:g} m high"
    name = f"prism_{count}{_named('', (radius, height))}"
    return extrusion(name, "Prism", doc, outline, height, mass=mass, friction=friction)


def extrusion(
    name: str,
    prim: str,
    doc: str,
    outline: BaseGeometry,
    height: float,
    *,
    mass: float | None = None,
    friction: float = FRICTION,
    color: Color = WOOD,
) -> FlatObject:
    """Extrudes an outline, which may have holes, to a given thickness.

    Args:
        name, prim, doc: Name of the object's file, name of its prim, and description.
        outline: Polygons, seen from above, about the object's origin [m].
        height: Thickness [m].
        mass: Mass [kg]; ``None``: computed from the density of wood.
        friction: Coulomb coefficient with the table.
        color: Red, green and blue, each from 0 to 1.

    Raises:
        ConfigError: A length (that of the outline's bounding box, or the height), the mass or the friction is invalid.
    """
    x0, y0, x1, y1 = outline.bounds
    checked_sides(doc, x1 - x0, y1 - y0, height)
    weight = checked_mass(mass, shapely.area(outline) * height)
    return FlatObject(name, prim, doc, convex_pieces(outline), height, weight, checked_friction(friction), color)


def checked_sides(what: str, *lengths: float) -> tuple[float, ...]:
    """Returns side lengths, if they are neither too small for the tool nor too large for the arm (:data:`SIDES`).

    Args:
        what: Name of the object, for the error.
        *lengths: The side lengths [m].

    Raises:
        ConfigError: A length is out of range.
    """
    low, high = SIDES
    for length in lengths:
        if not low <= length <= high:
            meant = low <= length / 1000.0 <= high
            unit = f"\n  to do:   give it in metres: {length / 1000.0:g} if {length:g} mm were meant" if meant else ""
            raise ConfigError(
                f"{what}: a side of {length:.4g} m is out of range\n  allowed: {low:g} to {high:g} m per side{unit}"
            )
    return lengths


def checked_mass(mass: float | None, volume: float) -> float:
    """Returns the mass of an object [kg].

    Args:
        mass: The requested mass [kg]; ``None``: that of ``volume`` of wood (:data:`DENSITY`), at least 0.01 kg.
        volume: Volume of the object [m^3].

    Raises:
        ConfigError: The requested mass is not 0.001 to 20 kg.
    """
    if mass is None:
        return max(round(DENSITY * volume, 2), 0.01)
    if not (math.isfinite(mass) and 0.001 <= mass <= 20.0):
        raise ConfigError(f"--mass {mass:g}: out of range\n  allowed: 0.001 to 20 kg")
    return mass


def checked_friction(friction: float) -> float:
    """Returns a Coulomb coefficient, if it is above 0 and at most 2.

    Raises:
        ConfigError: It is out of this range.
    """
    if not (math.isfinite(friction) and 0.0 < friction <= 2.0):
        raise ConfigError(f"--friction {friction:g}: out of range\n  allowed: more than 0, up to 2")
    return friction


def _named(word: str, lengths: tuple[float, ...]) -> str:
    """Returns a file name that includes the sizes in millimetres."""
    return "_".join([word, *(f"{1000 * length:.4g}".replace(".", "p") for length in lengths)])


def check_height(file: Path, height: float) -> None:
    """Checks that an object is high enough for the stick.

    Args:
        file: Its file, for the error.
        height: Its height in its pose on the table [m].

    Raises:
        SceneError: It is too flat.
    """
    if height < LOWEST:
        raise SceneError(
            f"the object is too flat for the stick: {1000 * height:.1f} mm high in this pose",
            file=file,
            allowed=f"{1000 * LOWEST:.0f} mm or more",
            fix="make the part thicker, or stand it up in your modelling program; a mesh then needs --lay as-is",
        )
