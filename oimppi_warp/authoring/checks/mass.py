"""Checks whether an object's mass and inertia are plausible for its size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
import trimesh

from oimppi_warp.geometry.feasibility import object_outline
from oimppi_warp.geometry.footprint import height_range
from oimppi_warp.scene import Scene
from oimppi_warp.usd.colliders import solid
from oimppi_warp.usd.stage import SceneStage

DENSITIES = (10.0, 20000.0)
"""Plausible densities, from light foam to gold [kg/m^3]."""

FACTOR = 4.0
"""Allowed ratio of the inertia to a uniform solid's: a hollow cube has 5/3 of it, one with a lead core a quarter."""


@dataclass(frozen=True)
class MassWarning:
    """An implausible mass property: the value found, the range allowed, and the remedy."""

    what: str
    allowed: str
    fix: str


def mass_warnings(scene: Scene, stage: SceneStage, inertia: np.ndarray | None) -> Iterator[MassWarning]:
    """Yields warnings about implausible mass properties of the object.

    Args:
        scene: The task.
        stage: The stage it was read from.
        inertia: Principal moments given in its file, shape [3] [kg m^2]; ``None`` if they are computed from the shapes.
    """
    body = scene.object
    solids = [solid(collider) for collider in body.colliders]
    volume = sum(float(solid.volume) for solid in solids)
    density = body.mass / volume
    if not DENSITIES[0] <= density <= DENSITIES[1]:
        yield MassWarning(
            f"a mass of {body.mass:g} kg in a volume of {1000.0 * volume:.3g} litres is {density:.3g} kg/m^3",
            f"{DENSITIES[0]:g} (foam) to {DENSITIES[1]:g} (gold) kg/m^3",
            "correct physics:mass, or the size of the shapes",
        )
    if inertia is not None:
        uniform = _trace(solids, density)
        ratio = float(inertia.sum()) / uniform
        if not 1.0 / FACTOR <= ratio <= FACTOR:
            yield MassWarning(
                f"physics:diagonalInertia is {ratio:.3g} times that of a uniform solid of this shape and mass",
                f"{1.0 / FACTOR:g} to {FACTOR:g} times",
                "correct it, or leave it out to have it computed from the shapes and the mass",
            )
    low, high = height_range(body.colliders)
    x, y, z = body.center_of_mass
    hull = shapely.convex_hull(object_outline(scene, (0.0, 0.0, 0.0)))
    if not (low <= z <= high and shapely.contains_xy(hull, x, y)):
        yield MassWarning(
            f"physics:centerOfMass ({x:.3g}, {y:.3g}, {z:.3g}) is outside the object",
            "a point within its convex hull, in the object's frame",
            "correct it, or leave it out to have it computed from the shapes",
        )


def _trace(solids: list[trimesh.Trimesh], density: float) -> float:
    """Returns the sum of the moments of inertia of uniform solids about their common centre [kg m^2]."""
    volumes = np.array([solid.volume for solid in solids])
    centers = np.array([solid.center_mass for solid in solids])
    away = centers - np.average(centers, axis=0, weights=volumes)
    own = sum(float(np.trace(solid.moment_inertia)) for solid in solids)
    return density * (own + 2.0 * float(volumes @ (away**2).sum(axis=1)))
