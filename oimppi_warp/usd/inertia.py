"""Reads the mass of a rigid body, its centre of mass, and its inertia.

Where a file gives no inertia or no centre of mass, none is invented: they follow from the colliders, at uniform
density, when a model is built (:mod:`oimppi_warp.physics.newton_model`). OpenUSD's and Newton's readers do the same.
Masses and densities of the single shapes of an object are read by :mod:`oimppi_warp.usd.densities`.
"""

from __future__ import annotations

import math

import numpy as np
from pxr import Gf, Usd, UsdPhysics

from oimppi_warp.usd.frames import shortest_decimal
from oimppi_warp.usd.stage import SceneStage


def read_mass(scene: SceneStage, body: Usd.Prim) -> float:
    """Reads the mass of a rigid body [kg].

    Raises:
        SceneError: The mass is missing, not finite, or not above zero.
    """
    mass = scene.number(body, "physics:mass", 0.0) if body.HasAPI(UsdPhysics.MassAPI) else 0.0
    if not (math.isfinite(mass) and mass > 0.0):
        what = f"the mass is {mass:g} kg" if mass else "the body has no mass"
        fix = "apply PhysicsMassAPI and set physics:mass"
        raise scene.error(what, body, allowed="a finite mass above zero", fix=fix)
    return mass


def given_center(body: Usd.Prim) -> np.ndarray | None:
    """Returns a body's physics:centerOfMass, in its frame before scaling, shape [3] [m]; ``None`` if it has none."""
    value = UsdPhysics.MassAPI(body).GetCenterOfMassAttr().Get()
    center = np.array([shortest_decimal(c) for c in value or [math.nan]])
    return center if np.isfinite(center).all() else None


def given_moments(body: Usd.Prim) -> np.ndarray | None:
    """Returns a body's physics:diagonalInertia, shape [3] [kg m^2]; ``None`` if it is to follow from the shapes."""
    if not body.HasAPI(UsdPhysics.MassAPI):
        return None
    value = UsdPhysics.MassAPI(body).GetDiagonalInertiaAttr().Get()
    moments = np.zeros(3) if value is None else np.array(value, dtype=float)
    return moments if np.isfinite(moments).all() and moments.any() else None


def unit_inertia(body: Usd.Prim, mass: float) -> np.ndarray | None:
    """Returns the inertia about the centre of mass that the file gives for a body, divided by its mass.

    ``newton:inertia`` takes precedence over principal moments and axes, as in Newton.

    Args:
        body: The prim.
        mass: Its mass [kg].

    Returns:
        Inertia per mass in the axes of the body's frame, shape [3, 3] [m^2]; ``None`` if the file gives none.
    """
    inertia = given_tensor(body)
    if inertia is None:
        moments = given_moments(body)
        if moments is None or (moments < 0.0).any():
            return None
        axes = UsdPhysics.MassAPI(body).GetPrincipalAxesAttr().Get()
        if axes is None or axes == Gf.Quatf(0.0):
            axes = Gf.Quatf(1.0)
        turn = _rotation(np.array([*axes.GetImaginary(), axes.GetReal()], dtype=np.float32))
        inertia = turn @ np.diag(moments.astype(np.float32)) @ turn.T
    return inertia.astype(float) / mass if mass > 0.0 else None


def given_tensor(body: Usd.Prim) -> np.ndarray | None:
    """Returns the value of ``newton:inertia``, moments xx, yy, zz and products xy, xz, yz, as a matrix [3, 3]."""
    attribute = body.GetAttribute("newton:inertia")
    value = attribute.Get() if attribute and attribute.HasAuthoredValue() else None
    applied = "NewtonMassAPI" in body.GetPrimTypeInfo().GetAppliedAPISchemas()
    if not applied or value is None or len(value) != 6 or not np.isfinite(np.array(value, dtype=float)).all():
        return None
    xx, yy, zz, xy, xz, yz = map(float, value)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return tensor if (np.linalg.eigvalsh(tensor) >= 0.0).all() else None


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Returns the rotation matrix of a quaternion xyzw, in single precision and with Newton's order of operations."""
    x, y, z, w = quaternion
    quaternion = quaternion * (np.float32(1.0) / np.sqrt(x * x + y * y + z * z + w * w))
    q, w = quaternion[:3], quaternion[3]
    one, two = np.float32(1.0), np.float32(2.0)
    columns = [
        axis * (two * w * w - one) + q * (two * (q @ axis)) + np.cross(q, axis) * w * two
        for axis in np.eye(3, dtype=np.float32)
    ]
    return np.stack(columns, axis=1)
