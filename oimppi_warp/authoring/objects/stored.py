"""Objects that a USD file holds already: of one's own making, or imported before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from pxr import Usd

from oimppi_warp.authoring.bundle import copy_bundle
from oimppi_warp.authoring.prims import Color, Look, mesh
from oimppi_warp.footprint import core_points, height_range
from oimppi_warp.scene import Collider, PushedObject
from oimppi_warp.usd.colliders import ALLOWED, collider_prims, read_colliders, volume_and_center
from oimppi_warp.usd.robot import read_mass
from oimppi_warp.usd.stage import SceneStage

GREY: Color = (0.45, 0.47, 0.5)


@dataclass(frozen=True, eq=False)
class Stored:
    """An object in a USD file.

    Attributes:
        file: The file.
        name: Name of its file where it is copied to.
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
        ball = trimesh.creation.icosphere(2)
        for number, collider in enumerate(self.colliders):
            points, radius = core_points(collider)
            if radius:
                points = (points[:, None] + radius * ball.vertices).reshape(-1, 3)
            hull = trimesh.convex.convex_hull(points)
            mesh(stage, f"{root}/piece{number}", np.asarray(hull.vertices), hull.faces.tolist(), look)

    def write(self, file: Path, *, note: str = "") -> None:
        """Copy the object's file, and what it refers to; it says already what it is."""
        copy_bundle(self.file, file.parent, file.name)


def read_object(file: str | Path) -> Stored:
    """An object in a USD file: its default prim, with a mass and convex colliders, in metres and z up.

    Raises:
        SceneError: It is none.
    """
    stage = SceneStage(Path(file).expanduser().resolve())
    root = stage.stage.GetDefaultPrim()
    if not root:
        fix = 'name the object\'s root in the file: defaultPrim = "..."'
        raise stage.error("a file without a default prim cannot be referred to", fix=fix)
    if stage.role("OimppiTaskAPI"):
        allowed = "an object: a default prim with PhysicsMassAPI and colliders, as `oimppi scene import` writes them"
        raise stage.error("a whole scene, not an object", root, allowed=allowed)
    read_mass(stage, root)
    colliders = read_colliders(stage, root, stage.body_frame(root))
    if not colliders:
        fix = "apply PhysicsCollisionAPI to a shape at it or below it"
        raise stage.error("an object without a collider", root, allowed=ALLOWED, fix=fix)
    doc = str(stage.stage.GetRootLayer().documentation).partition(". ")[0] or f"the object {stage.file.stem}"
    return Stored(stage.file, stage.file.stem, doc, colliders)


def read_body(file: Path) -> PushedObject:
    """The object in a USD file as the planner takes it, its friction that of its own material.

    Raises:
        SceneError: It is none.
    """
    thing, stage = read_object(file), SceneStage(file.resolve())
    root = stage.stage.GetDefaultPrim()
    frictions = [stage.friction(prim) or 0.0 for prim in collider_prims(root)]
    volumes = [volume_and_center(stage, collider) for collider in thing.colliders]
    center = np.average([center for _, center in volumes], axis=0, weights=[volume for volume, _ in volumes])
    given = root.GetAttribute("physics:centerOfMass").Get()
    return PushedObject(
        path=str(root.GetPath()),
        mass=read_mass(stage, root),
        friction=max(frictions),
        tool_friction=max(frictions),
        center_of_mass=center if given is None else np.array(given, dtype=float),
        colliders=thing.colliders,
        rest_height=thing.rest_height,
    )


def is_object_file(file: Path) -> bool:
    """Whether a file's name is that of a USD file."""
    return file.suffix in (".usda", ".usd", ".usdc", ".usdz")
