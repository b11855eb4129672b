"""Meshes as colliders: their triangles, and the simple shapes that replace them.

Colliders are convex. A mesh that is already convex is represented by its hull; `boundingCube` and `boundingSphere`
become a box and a sphere below the mesh, in the stage's session layer, so that every reader of the stage sees the same
shapes.
"""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

from oimppi_warp.usd.conversion.units import editable_prims

_TOKENS = UsdPhysics.Tokens
_REPLACED = (_TOKENS.none, _TOKENS.boundingCube, _TOKENS.boundingSphere)

CONVEX = 1e-3
"""Share of its hull's volume that a mesh may lack and still count as convex."""


def approximation(prim: Usd.Prim) -> str:
    """Returns a mesh's physics:approximation; "none", the mesh itself, if it is not set."""
    if not prim.HasAPI(UsdPhysics.MeshCollisionAPI):
        return _TOKENS.none
    return UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() or _TOKENS.none


def simplify_meshes(stage: Usd.Stage) -> None:
    """Authors the convex shapes that replace colliding meshes, wherever they are unambiguous."""
    proxies = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
    if not any(_is_replaced(prim) for prim in proxies):
        return
    for prim in editable_prims(stage):
        if _is_replaced(prim) and (faces := triangles(prim)) is not None:
            points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=float)
            if approximation(prim) != _TOKENS.none:
                _replace(stage, prim, points)
            elif _is_convex(points, faces):
                UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(_TOKENS.convexHull)


def triangles(prim: Usd.Prim) -> np.ndarray | None:
    """Returns a mesh's faces as triangles: indices of its points, shape [n, 3].

    Returns ``None`` if the faces are invalid or refer to points that do not exist.
    """
    mesh = UsdGeom.Mesh(prim)
    points = mesh.GetPointsAttr().Get() or []
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], dtype=int)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], dtype=int)
    whole = len(counts) > 0 and counts.min() >= 3 and counts.sum() == len(corners)
    if not whole or corners.min() < 0 or corners.max() >= len(points):
        return None
    firsts = np.cumsum(counts) - counts
    fans = [(first, first + i, first + i + 1) for first, n in zip(firsts, counts, strict=True) for i in range(1, n - 1)]
    return corners[np.array(fans)]


def enclosing(points: np.ndarray, faces: np.ndarray) -> np.ndarray | None:
    """Returns the triangles of a mesh that enclose its material, oriented outwards.

    Args:
        points: Vertices, not all in one plane, shape [n, 3] [m]; some may coincide.
        faces: Triangles in any orientation, as indices of the vertices, shape [m, 3].

    Returns:
        Triangles, shape [k, 3]; ``None`` if the surface is open, has no inside, or encloses nothing.
    """
    import trimesh

    from oimppi_warp.geometry.orient import orient

    surface = trimesh.Trimesh(points, faces)  # vertices that coincide are merged, and the faces keep their order
    corners = np.sort(surface.faces, axis=1)
    whole = (corners[:, 1:] != corners[:, :-1]).all(axis=1)
    surface.update_faces(whole)
    before = surface.faces.copy()
    if not surface.is_winding_consistent:
        orient(surface)
        trimesh.repair.fix_inversion(surface, multibody=True)
    if not (surface.is_watertight and surface.is_winding_consistent):
        return None
    if surface.volume < 0.0:
        surface.invert()
    if surface.volume < CONVEX * surface.convex_hull.volume:
        return None
    turned = (surface.faces != before).any(axis=1)
    return np.where(turned[:, None], faces[whole][:, ::-1], faces[whole])


def _is_replaced(prim: Usd.Prim) -> bool:
    if not (prim.IsA(UsdGeom.Mesh) and prim.HasAPI(UsdPhysics.CollisionAPI)):
        return False
    enabled = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get()
    return bool(enabled) and approximation(prim) in _REPLACED


def _is_convex(points: np.ndarray, faces: np.ndarray) -> bool:
    """Returns whether a closed surface fills its convex hull."""
    if not np.isfinite(points).all() or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 3:
        return False
    import trimesh

    closed = enclosing(points, faces)
    if closed is None:
        return False
    hull = trimesh.convex.convex_hull(points)
    return abs(trimesh.Trimesh(points, closed, process=False).volume - hull.volume) < CONVEX * hull.volume


def _replace(stage: Usd.Stage, prim: Usd.Prim, points: np.ndarray) -> None:
    """Replaces a mesh by a box or a sphere that encloses all of its points, aligned with the mesh's own axes."""
    path = prim.GetPath().AppendChild("bounds")
    if not np.isfinite(points).all():
        return
    lower, upper = points.min(axis=0), points.max(axis=0)
    if approximation(prim) == _TOKENS.boundingCube:
        shape = UsdGeom.Cube.Define(stage, path)
        shape.CreateSizeAttr(1.0)
        shape.AddTranslateOp().Set(Gf.Vec3d(*((lower + upper) / 2.0).tolist()))
        shape.AddScaleOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*(upper - lower).tolist()))
    else:
        import trimesh

        center, radius = trimesh.nsphere.minimum_nsphere(points)
        shape = UsdGeom.Sphere.Define(stage, path)
        shape.CreateRadiusAttr(float(radius))
        shape.AddTranslateOp().Set(Gf.Vec3d(*np.asarray(center).tolist()))
    shape.CreatePurposeAttr(UsdGeom.Tokens.guide)
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
    if material:
        UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material, materialPurpose="physics")
    prim.RemoveAPI(UsdPhysics.CollisionAPI)
