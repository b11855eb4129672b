"""Objects made from MJCF files: one rigid body, as MuJoCo's own compiler resolves it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from oimppi_warp.authoring.meshes.convex import CORNERS, Fit
from oimppi_warp.authoring.meshes.hulls import Hull, limited_hull
from oimppi_warp.authoring.meshes.pose import Lay, lay_on_table
from oimppi_warp.authoring.meshes.solid import DISPLAY_FACES, STEEL, MeshObject, plain_name
from oimppi_warp.authoring.mjcf import compiled
from oimppi_warp.authoring.objects.outlines import SIZES, check_height, checked_friction, checked_mass
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import collider_mesh, rotation_matrix
from oimppi_warp.scene import Collider

if TYPE_CHECKING:
    import mujoco

ALLOWED = "one rigid body: a <body> with geoms, without joints other than a <freejoint/>"

HOLLOW = 0.1
"""Share of its convex hull that a mesh may leave empty without a remark."""

_ROUNDED = 0.05
"""Relative error of a rounded inertia."""
_OTHER_UNIT = 30.0
"""Ratio of an inertia to the largest possible one from which on it is in another unit, such as g m^2."""
_SHAPES = "box, sphere, capsule, cylinder, ellipsoid or mesh"


@dataclass
class _Body:
    """A body as it was read, with all that is welded to it, in its own frame.

    Attributes:
        mass: Mass [kg]; 0 if the file gives none, as for the world.
        center: Centre of mass, shape [3] [m]; zeros without a mass.
        inertia: Inertia about the centre of mass, shape [3, 3] [kg m^2].
        hulls: Its colliding shapes.
        surfaces: Its shapes that are only shown.
        frictions: Sliding friction of the colliding shapes.
        hollow: Names of meshes that fill their hull badly, with the empty share.
    """

    mass: float = 0.0
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    hulls: list[Hull] = field(default_factory=list)
    surfaces: list[Hull] = field(default_factory=list)
    frictions: list[float] = field(default_factory=list)
    hollow: dict[str, float] = field(default_factory=dict)


def import_mjcf(
    file: str | Path,
    *,
    name: str | None = None,
    mass: float | None = None,
    friction: float | None = None,
    lay: Lay = "stable",
) -> MeshObject:
    """Imports the rigid body in an MJCF file as an object; defaults, includes and meshes are resolved.

    Each mesh collides as its convex hull, as in MuJoCo. Shapes of the world are left out if there is a body.

    Args:
        file: The MJCF file.
        name: Name of the object; ``None``: the file's name without its extension.
        mass: Mass [kg]; ``None``: the body's own.
        friction: Coulomb coefficient with the table; ``None``: the largest of its geoms' sliding frictions.
        lay: Pose on the table: ``"stable"`` (its most stable pose), ``"flat"`` (its most stable one in which it does
            not roll) or ``"as-is"`` (as in the body's frame, z up).

    Raises:
        ConfigError: A number is invalid.
        SceneError: The file cannot be read, or does not hold one rigid body of a size that can be pushed.
    """
    file = Path(file).expanduser()
    model = _model(file)
    _check_joints(file, model)
    number = _only_body(file, model)
    body = _read_shapes(file, model, number)
    _read_mass(model, number, body)
    union = trimesh.util.concatenate([trimesh.Trimesh(*hull, process=False) for hull in body.hulls])
    assert isinstance(union, trimesh.Trimesh)
    _check_size(file, union)
    if body.mass > 0.0:
        center, unit_inertia = body.center, body.inertia / body.mass
        doubts = _check_inertia(file, union, center, unit_inertia)
    else:  # a --mass is that of a uniform solid
        doubts = ()
        center, unit_inertia = np.asarray(union.center_mass), union.moment_inertia / union.volume
    if mass is None and body.mass <= 0.0:
        raise SceneError(
            "the body has no mass",
            file=file,
            allowed="a mass, a density or an <inertial> for the body",
            fix="add one to the file, or use --mass",
        )
    weight = checked_mass(mass, 0.0) if mass is not None else body.mass
    motion, done = lay_on_table(union, lay, file, center=center)
    check_height(file, float(union.extents[2]))
    turn = motion[:3, :3]
    size = " x ".join(f"{side:.3g}" for side in union.extents)
    notes = [done, *doubts]
    for each, share in body.hollow.items():
        notes.append(
            f"warning: the mesh {each} leaves {100 * share:.0f} % of its convex hull empty, and collides as its hull, "
            "as in MuJoCo; to have it cut into convex pieces, import the mesh file itself"
        )
    return MeshObject(
        name=plain_name(name or file.stem),
        about=f"a body of {size} m, from {file.name}",
        hulls=tuple(_moved(hull, motion) for hull in body.hulls),
        surface=tuple(_moved(each, motion) for each in _shown(body)),
        mass=weight,
        friction=_friction(file, body) if friction is None else checked_friction(friction),
        center=turn @ center + motion[:3, 3],
        inertia=weight * turn @ unit_inertia @ turn.T,
        fit=Fit(0.0, 0.0, 0.0),
        notes=tuple(notes),
        color=STEEL,
    )


def _check_inertia(file: Path, surface: trimesh.Trimesh, center: np.ndarray, inertia: np.ndarray) -> tuple[str, ...]:
    """Returns a warning, as notes, if an inertia is impossible for this shape, however the mass is distributed.

    Args:
        file: The file.
        surface: Surface of the body.
        center: Centre of mass, shape [3] [m].
        inertia: Inertia about it per kilogram, shape [3, 3] [m^2].

    Raises:
        SceneError: It is so much larger that it must be in another unit.
    """
    largest = 2.0 * float((np.linalg.norm(surface.vertices - center, axis=1) ** 2).max())
    times = float(np.trace(inertia)) / largest
    if times > _OTHER_UNIT:
        moments = ", ".join(f"{moment:.3g}" for moment in np.linalg.eigvalsh(inertia))
        raise SceneError(
            f"the body has a physically impossible inertia for its size: moments of {moments} kg m^2 per kilogram",
            file=file,
            allowed=f"moments with a sum of up to {largest:.2g} kg m^2 per kilogram, for this shape",
            fix="give the <inertial> in kg m^2, or leave it out to have it computed from the shapes",
        )
    if times <= 1.0 + _ROUNDED:
        return ()
    return (f"warning: its inertia is {times:.2g} times the largest that a body of this shape and mass can have",)


def _model(file: Path) -> mujoco.MjModel:
    """Returns the model of a file.

    Raises:
        SceneError: The file is not MJCF, or it cannot be compiled.
    """
    if not file.is_file():
        raise SceneError("there is no such file", file=file, allowed="an MJCF file")
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, UnicodeDecodeError, ValueError) as error:
        raise SceneError(f"the file cannot be read as XML ({error})", file=file, allowed="an MJCF file") from None
    if root.tag != "mujoco":
        fix = "a robot in a URDF is imported by `oimppi scene robot`" if root.tag == "robot" else "convert it to MJCF"
        what = f"the root element is <{root.tag}>"
        raise SceneError(what, file=file, allowed="an MJCF file, with the root element <mujoco>", fix=fix)
    return compiled(file)


def _check_joints(file: Path, model: mujoco.MjModel) -> None:
    """Raises SceneError if anything in the file has joints, and is therefore no rigid body."""
    import mujoco

    moving = [
        model.joint(joint).name or f"the joint of {_body_name(model, model.jnt_bodyid[joint])}"
        for joint in range(model.njnt)
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE
    ]
    if moving:
        raise SceneError(
            f"the file has {len(moving)} joint{'' if len(moving) == 1 else 's'} ({_listed(moving)})",
            file=file,
            allowed=ALLOWED,
            fix="remove the joints, so that the parts are one body; a robot is imported by `oimppi scene robot`",
        )


def _only_body(file: Path, model: mujoco.MjModel) -> int:
    """Returns the number of the only body of the world with colliding shapes; 0 if they all belong to the world."""
    owners = {int(model.body_rootid[model.geom_bodyid[geom]]) for geom in range(model.ngeom) if _collides(model, geom)}
    bodies = sorted(owners - {0})
    if len(bodies) > 1:
        names = [_body_name(model, body) for body in bodies]
        fix = "keep one of them, or put one inside the other without a joint"
        raise SceneError(f"the file has {len(bodies)} bodies ({_listed(names)})", file=file, allowed=ALLOWED, fix=fix)
    if not owners:
        raise SceneError(
            "nothing in the file collides",
            file=file,
            allowed=f"geoms that collide: {_SHAPES}, with contype or conaffinity above zero",
            fix="let its geoms collide, or import its mesh file instead",
        )
    return bodies[0] if bodies else 0


def _body_name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body {body}"


def _collides(model: mujoco.MjModel, geom: int) -> bool:
    paired = ((model.pair_geom1 == geom) | (model.pair_geom2 == geom)).any()
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom] or paired)


def _read_mass(model: mujoco.MjModel, root: int, found: _Body) -> None:
    """Adds up the mass, the centre of mass and the inertia of a body and those welded to it; the world has none."""
    parts = [body for body in range(1, model.nbody) if root and model.body_rootid[body] == root]
    masses = np.array([model.body_mass[body] for body in parts])
    if not masses.sum() > 0.0:
        return
    frames = [_body_frame(model, body, root) @ _frame(model.body_ipos[body], model.body_iquat[body]) for body in parts]
    found.mass = float(masses.sum())
    found.center = np.average([frame[:3, 3] for frame in frames], axis=0, weights=masses)
    for body, mass, frame in zip(parts, masses, frames, strict=True):
        turn, away = frame[:3, :3], frame[:3, 3] - found.center
        own = turn @ np.diag(model.body_inertia[body]) @ turn.T
        found.inertia += own + mass * (away @ away * np.eye(3) - np.outer(away, away))


def _read_shapes(file: Path, model: mujoco.MjModel, root: int) -> _Body:
    """Reads the shapes of a body and those welded to it; raises SceneError for one without a volume."""
    import mujoco

    found = _Body()
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body_rootid[body] != root:
            continue
        collides, mesh = _collides(model, geom), _shape(model, geom)
        if mesh is None:
            if not collides or not root:  # the world's floor, for example
                continue
            kind = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
            fix = f"replace the geom {model.geom(geom).name or geom}, or remove it"
            raise SceneError(f"a geom is a {kind}", file=file, allowed=f"{_SHAPES}: solids that can move", fix=fix)
        mesh.apply_transform(_body_frame(model, body, root) @ _frame(model.geom_pos[geom], model.geom_quat[geom]))
        if not collides:
            found.surfaces.append((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
            continue
        hull = limited_hull(mesh.vertices, CORNERS)
        found.hulls.append(hull)
        found.frictions.append(float(model.geom_friction[geom, 0]))
        volume = trimesh.Trimesh(*hull).volume
        if mesh.is_watertight and abs(mesh.volume) < (1.0 - HOLLOW) * volume:
            name = model.mesh(int(model.geom_dataid[geom])).name
            found.hollow[name] = 1.0 - abs(float(mesh.volume)) / volume
            found.surfaces.append((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    if not found.hulls:
        raise SceneError("no body in the file collides", file=file, allowed=ALLOWED, fix="add a <body> with geoms")
    return found


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Returns a geom as a mesh in its own frame [m]; ``None`` for one without a volume, such as a plane."""
    import mujoco

    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    a, b, c = (float(size) for size in model.geom_size[geom])
    if kind == kinds.mjGEOM_MESH:
        number = int(model.geom_dataid[geom])
        first, face = int(model.mesh_vertadr[number]), int(model.mesh_faceadr[number])
        points = model.mesh_vert[first : first + int(model.mesh_vertnum[number])]
        return trimesh.Trimesh(points, model.mesh_face[face : face + int(model.mesh_facenum[number])])
    if kind == kinds.mjGEOM_ELLIPSOID:
        mesh = trimesh.creation.icosphere(2)
        mesh.apply_scale((a, b, c))
        return mesh
    if kind == kinds.mjGEOM_BOX:
        return collider_mesh(Collider("", "box", _HERE, (a, b, c)))
    if kind == kinds.mjGEOM_SPHERE:
        return collider_mesh(Collider("", "sphere", _HERE, (a,)))
    if kind in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
        name = "capsule" if kind == kinds.mjGEOM_CAPSULE else "cylinder"
        return collider_mesh(Collider("", name, _HERE, (a, b)))
    return None


def _body_frame(model: mujoco.MjModel, body: int, root: int) -> np.ndarray:
    """Returns the pose of a body in the frame of the one that it is welded to, shape [4, 4] [m]."""
    frame = np.eye(4)
    while body != root:
        frame = _frame(model.body_pos[body], model.body_quat[body]) @ frame
        body = int(model.body_parentid[body])
    return frame


def _frame(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Returns the transform of a position [m] and of MuJoCo's quaternion wxyz, shape [4, 4]."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation_matrix(quaternion[[1, 2, 3, 0]]), position
    return frame


_HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def _shown(body: _Body) -> list[Hull]:
    """Returns the surfaces to display, if they are not too many triangles."""
    return body.surfaces if sum(len(faces) for _, faces in body.surfaces) <= DISPLAY_FACES else []


def _check_size(file: Path, union: trimesh.Trimesh) -> None:
    """Raises SceneError for a size that the arm cannot push."""
    low, high = SIZES
    if not low <= float(union.extents.max()) <= high:
        size = " x ".join(f"{side:.3g}" for side in union.extents)
        raise SceneError(
            f"the body is too {'large' if union.extents.max() > high else 'small'} for the arm: {size} m",
            file=file,
            allowed=f"{low:g} to {high:g} m for the longest side",
            fix='scale its geoms; a mesh in millimetres needs scale="0.001 0.001 0.001" in <asset>',
        )


def _friction(file: Path, body: _Body) -> float:
    largest = max(body.frictions)
    if not 0.0 < largest <= 2.0:
        raise SceneError(
            f"the sliding friction of its geoms is {largest:g}",
            file=file,
            allowed="more than 0, up to 2",
            fix="correct the first number of friction, or use --friction",
        )
    return largest


def _moved(hull: Hull, motion: np.ndarray) -> Hull:
    return trimesh.transformations.transform_points(hull[0], motion), hull[1]


def _listed(names: list[str]) -> str:
    """Lists a few names."""
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
