"""Objects that a USD file holds already: of one's own making, or imported before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdShade

from oimppi_warp.authoring.bundle import write_flat
from oimppi_warp.authoring.prims import Color, Look, apply_api, mesh
from oimppi_warp.footprint import collider_mesh, height_range
from oimppi_warp.scene import Collider, PushedObject
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders
from oimppi_warp.usd.inertia import read_mass, unit_inertia
from oimppi_warp.usd.stage import SceneStage
from oimppi_warp.usd.things import center_of_mass, largest_friction
from oimppi_warp.usd.upright import stand_upright

GREY: Color = (0.45, 0.47, 0.5)

ENDINGS = (".usda", ".usd", ".usdc", ".usdz")
"""Of USD files."""

_ROLES = ("OimppiObjectAPI", "PhysicsRigidBodyAPI")
"""What the scene makes of an object, which may stand fast in another."""


@dataclass(frozen=True, eq=False)
class Stored:
    """An object in a USD file.

    Attributes:
        file: The file.
        name: Name of its file where it is written to.
        doc: What it is.
        colliders: Its shapes in its frame.
        color: Its ghost at the goal is drawn in.
    """

    file: Path
    name: str
    doc: str
    colliders: tuple[Collider, ...]
    color: Color = GREY

    @property
    def rest_height(self) -> float:
        """Height of its frame when it lies on the table [m]."""
        return round(-float(height_range(self.colliders)[0]), 6)

    @property
    def turns(self) -> bool:
        """Whether its yaw can be seen."""
        return True

    def draw(self, stage: Usd.Stage, root: str, look: Look) -> None:
        """Write the hulls of its shapes below ``root``."""
        for number, collider in enumerate(self.colliders):
            hull = collider_mesh(collider)
            mesh(stage, f"{root}/piece{number}", np.asarray(hull.vertices), hull.faces.tolist(), look)

    @property
    def ready(self) -> bool:
        """Whether a scene may refer to its file as it is: in SI units, z up, nothing read otherwise, not moved."""
        stage = SceneStage(self.file)
        return stage.stage.GetSessionLayer().empty and not _operations(stage.stage.GetDefaultPrim())

    def write(self, file: Path, *, note: str = "") -> None:
        """Write the object as it is read, in one file that says already what it is; its textures go beside it."""
        flat = _open(self.file).stage.Flatten(addSourceFileComment=False)
        stage = Usd.Stage.Open(flat)
        root = stage.GetDefaultPrim()
        for name in _operations(root):
            root.RemoveProperty(name)
        for role in _ROLES:
            root.RemoveAppliedSchema(role)
        write_flat(flat, file, self.file)


def read_object(file: str | Path) -> Stored:
    """An object in a USD file: its default prim, with a mass and convex colliders.

    Raises:
        SceneError: It is none.
    """
    stage = _open(Path(file).expanduser().resolve())
    root = stage.stage.GetDefaultPrim()
    read_mass(stage, root)
    frame = stage.body_frame(root)
    if frame.GetRow3(2)[2] < 1.0 - 1e-6:
        fix = "put the shapes below an Xform that is the default prim, and turn them there"
        raise stage.error("an object that does not lie flat", root, allowed="turned about z only", fix=fix)
    colliders = read_colliders(stage, root, frame)
    if not colliders:
        fix = "apply PhysicsCollisionAPI to a shape at it or below it"
        raise stage.error("an object without a collider", root, allowed=ALLOWED, fix=fix)
    for prim in collider_prims(root):
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if material and not material.GetPath().HasPrefix(root.GetPath()):
            what = f"its material <{material.GetPath()}> is not below the default prim, and would be left behind"
            raise stage.error(what, prim, allowed=f"a prim below <{root.GetPath()}>", fix="move it there")
    doc = str(stage.stage.GetRootLayer().documentation).partition(". ")[0] or f"the object {stage.file.stem}"
    return Stored(stage.file, stage.file.stem, doc, colliders)


def read_body(file: Path) -> PushedObject:
    """The object in a USD file as the planner takes it, its friction that of its own material.

    Raises:
        SceneError: It is none.
    """
    thing, stage = read_object(file), _open(file.resolve())
    root = stage.stage.GetDefaultPrim()
    friction, mass = largest_friction(stage, [root]), read_mass(stage, root)
    return PushedObject(
        path=str(root.GetPath()),
        mass=mass,
        friction=friction,
        tool_friction=friction,
        center_of_mass=center_of_mass(stage, root, thing.colliders),
        colliders=thing.colliders,
        rest_height=thing.rest_height,
        unit_inertia=unit_inertia(root, mass),
    )


def is_object_file(file: Path) -> bool:
    """Whether a file's name is that of a USD file."""
    return file.suffix in ENDINGS


def _open(file: Path) -> SceneStage:
    """The stage of an object's file, its default prim stood upright as an object of a scene is.

    Raises:
        SceneError: It has no default prim, or is a whole scene.
    """
    stage = SceneStage(file)
    root = stage.stage.GetDefaultPrim()
    if not root:
        fix = 'name the object\'s root in the file: defaultPrim = "..."'
        raise stage.error("a file without a default prim cannot be referred to", fix=fix)
    if stage.role("OimppiTaskAPI"):
        allowed = "an object: a default prim with PhysicsMassAPI and colliders, as `oimppi scene import` writes them"
        raise stage.error("a whole scene, not an object", root, allowed=allowed)
    apply_api(root, "OimppiObjectAPI")
    stand_upright(stage.stage)
    return stage


def _operations(prim: Usd.Prim) -> list[str]:
    """Names of what moves a prim in its file: a scene says itself where an object stands."""
    return [name for name in prim.GetAuthoredPropertyNames() if name.startswith("xformOp")]
