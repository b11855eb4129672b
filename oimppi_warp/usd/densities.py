"""Derives the mass of a body from the masses and densities of its shapes, as UsdPhysics defines it."""

from __future__ import annotations

import math

import numpy as np
from pxr import Gf, Usd, UsdPhysics, UsdShade

from oimppi_warp.scene import Collider
from oimppi_warp.usd.colliders import solid, volume_and_center
from oimppi_warp.usd.frames import scales
from oimppi_warp.usd.inertia import given_center, given_moments, given_tensor
from oimppi_warp.usd.stage import SceneStage

ALIKE = 1e-4
"""Relative difference up to which the densities of shapes count as equal."""


def gives_mass(body: Usd.Prim) -> bool:
    """Returns whether the file gives a mass for a body as a whole, usable or not."""
    return bool(UsdPhysics.MassAPI(body).GetMassAttr().Get()) if body.HasAPI(UsdPhysics.MassAPI) else False


def derive_mass(stage: SceneStage, body: Usd.Prim, colliders: tuple[Collider, ...], *, fix: str = "") -> None:
    """Gives a body without a mass the sum of its shapes' masses, in the stage's session layer.

    A shape's mass is its own ``physics:mass``, or its volume times its density. If densities differ, the centre of mass
    and the inertia are those of the shapes together, unless the file gives them.

    Args:
        stage: The stage.
        body: The body.
        colliders: Its shapes, in its frame.
        fix: Remedy to add to the error.

    Raises:
        SceneError: A shape has neither a mass nor a density, or one that is not above zero.
    """
    if gives_mass(body) or not colliders:
        return
    parts = [volume_and_center(collider) for collider in colliders]
    masses = np.array([_mass(stage, body, each, volume) for each, (volume, _) in zip(colliders, parts, strict=True)])
    if np.isnan(masses).any():
        lacking = f", and <{colliders[int(np.isnan(masses).argmax())].path}> has no density"
        raise stage.error(
            f"the body has no mass{'' if np.isnan(masses).all() else lacking}",
            body,
            allowed="a mass or a density above zero",
            fix=f"set physics:mass or physics:density with PhysicsMassAPI{fix}",
        )
    mass, density = float(masses.sum()), masses / [volume for volume, _ in parts]
    api = UsdPhysics.MassAPI.Apply(body)
    api.CreateMassAttr(mass)
    if np.ptp(density) <= ALIKE * density.max():
        return  # as of one material: readers compute the rest from the shapes
    center = np.average([center for _, center in parts], axis=0, weights=masses)
    if given_center(body) is None:
        api.CreateCenterOfMassAttr(Gf.Vec3f(*(center / scales(stage.frame(body))).tolist()))
    if given_moments(body) is None and given_tensor(body) is None:
        from scipy.spatial.transform import Rotation  # slow to import, and seldom needed

        moments, axes = np.linalg.eigh(_inertia(colliders, masses, center))
        axes[:, 2] *= math.copysign(1.0, float(np.linalg.det(axes)))
        x, y, z, w = Rotation.from_matrix(axes).as_quat().tolist()
        api.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
        api.CreatePrincipalAxesAttr(Gf.Quatf(w, x, y, z))


def _mass(stage: SceneStage, body: Usd.Prim, collider: Collider, volume: float) -> float:
    """Returns the mass of one shape [kg]; NaN if the file gives neither a mass nor a density."""
    prim = stage.stage.GetPrimAtPath(collider.path)
    own = prim if prim != body and prim.HasAPI(UsdPhysics.MassAPI) else None
    mass = stage.number(own, "physics:mass", 0.0) if own else 0.0
    if mass:
        return _above_zero(stage, prim, "physics:mass", mass)
    return _density(stage, body, prim) * volume


def _density(stage: SceneStage, body: Usd.Prim, shape: Usd.Prim) -> float:
    """Returns the density of one shape [kg/m^3]; NaN if there is none.

    A shape's own density takes precedence over that of its ancestors, up to the body, and that over its material's.
    """
    places = [stage.stage.GetPrimAtPath(path) for path in shape.GetPath().GetAncestorsRange()]
    places = [each for each in places if each.GetPath().HasPrefix(body.GetPath()) and each.HasAPI(UsdPhysics.MassAPI)]
    material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial("physics")
    if material and material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        places.append(material.GetPrim())
    for place in places:
        if density := stage.number(place, "physics:density", 0.0):
            return _above_zero(stage, place, "physics:density", density)
    return math.nan


def _above_zero(stage: SceneStage, prim: Usd.Prim, name: str, value: float) -> float:
    if not 0.0 < value < math.inf:
        raise stage.error(f"{name} is {value:g}", prim, allowed="a finite number above zero", fix="correct it")
    return value


def _inertia(colliders: tuple[Collider, ...], masses: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Returns the inertia of shapes of these masses [kg] about a point [m] of the body's frame, shape [3, 3]."""
    total = np.zeros((3, 3))
    for collider, mass in zip(colliders, masses, strict=True):
        body = solid(collider)
        away = body.center_mass - center
        total += mass * (body.moment_inertia / body.volume + away @ away * np.eye(3) - np.outer(away, away))
    return total
