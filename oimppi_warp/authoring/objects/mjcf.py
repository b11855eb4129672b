"""Objects made from MJCF files: one rigid body, read by Newton's importer."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from oimppi_warp.authoring.meshes.convex import CORNERS, Fit
from oimppi_warp.authoring.meshes.hulls import Hull, limited_hull
from oimppi_warp.authoring.meshes.pose import Lay, lay_on_table
from oimppi_warp.authoring.meshes.read import SIZES
from oimppi_warp.authoring.meshes.solid import DISPLAY_FACES, STEEL, MeshObject, check_height, plain_name
from oimppi_warp.authoring.objects.outlines import checked_friction, checked_mass
from oimppi_warp.compute.device import start_warp
from oimppi_warp.errors import SceneError
from oimppi_warp.geometry.footprint import collider_mesh
from oimppi_warp.scene import Collider

if TYPE_CHECKING:
    import newton

ALLOWED = "one rigid body: a <body> with geoms, without joints other than a <freejoint/>"

HOLLOW = 0.1
"""Share of its convex hull that a mesh may leave empty without a remark."""

_SHAPES = "box, sphere, capsule, cylinder, ellipsoid or mesh"


@dataclass
class _Body:
    """A body as it was read, in its own frame.

    Attributes:
        hulls: Its colliding shapes.
        surfaces: Its shapes that are only shown.
        frictions: Sliding friction of the colliding shapes.
        hollow: Names of meshes that fill their hull badly, with the empty share.
    """

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
    _check_xml(file)
    builder = _built(file)
    number = _only_body(file, builder)
    body = _read_shapes(file, builder, number)
    union = trimesh.util.concatenate([trimesh.Trimesh(*hull, process=False) for hull in body.hulls])
    assert isinstance(union, trimesh.Trimesh)
    _check_size(file, union)
    if number >= 0 and (own := float(builder.body_mass[number])) > 0.0:
        center = np.array(builder.body_com[number], dtype=float)
        unit_inertia = np.array(builder.body_inertia[number], dtype=float).reshape(3, 3) / own
    else:  # shapes of the world alone, which have no mass
        own, center, unit_inertia = 0.0, np.asarray(union.center_mass), union.moment_inertia / union.volume
    if mass is None and own <= 0.0:
        raise SceneError(
            "the body has no mass",
            file=file,
            allowed="a mass, a density or an <inertial> for the body",
            fix="add one to the file, or use --mass",
        )
    weight = checked_mass(mass, 0.0) if mass is not None else own
    motion, done = lay_on_table(union, lay, file, center=center)
    check_height(file, float(union.extents[2]))
    turn = motion[:3, :3]
    size = " x ".join(f"{side:.3g}" for side in union.extents)
    notes = [done]
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


def _check_xml(file: Path) -> None:
    """Checks that a file is MJCF, and that MuJoCo itself can compile it, whose messages give the line."""
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
    import mujoco

    try:
        mujoco.MjSpec.from_file(str(file)).compile()
    except Exception as error:  # ValueError, and what MuJoCo's readers of meshes raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(
            f"MuJoCo cannot read the file ({reason})",
            file=file,
            allowed="valid MJCF, with its included files and meshes in place",
            fix="correct what MuJoCo reports",
        ) from None


def _built(file: Path) -> newton.ModelBuilder:
    """Returns a builder with the content of a file; bodies that are welded together are one."""
    start_warp()
    import newton
    from newton.solvers import SolverMuJoCo

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    SolverMuJoCo.register_custom_attributes(builder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            builder.add_mjcf(
                str(file), floating=None, parse_sites=False, parse_mujoco_options=False, skip_equality_constraints=True
            )
            _check_joints(file, builder)
            builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
            SolverMuJoCo.register_custom_attributes(builder)
            builder.add_mjcf(
                str(file),
                floating=True,
                collapse_fixed_joints=True,
                parse_sites=False,
                parse_mujoco_options=False,
                skip_equality_constraints=True,
            )
    except SceneError:
        raise
    except Exception as error:  # readers of a dozen elements and formats raise many kinds of exceptions
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(
            f"Newton cannot read the file ({reason})",
            file=file,
            allowed="MJCF that Newton's importer supports",
            fix="simplify the element that the reason concerns",
        ) from None
    return builder


def _check_joints(file: Path, builder: newton.ModelBuilder) -> None:
    """Raises SceneError if anything in the file has joints, and is therefore no rigid body."""
    import newton

    still = (int(newton.JointType.FREE), int(newton.JointType.FIXED))
    moving = [
        label.rpartition("/")[2]
        for label, kind in zip(builder.joint_label, builder.joint_type, strict=True)
        if int(kind) not in still
    ]
    if moving:
        raise SceneError(
            f"the file has {len(moving)} joint{'' if len(moving) == 1 else 's'} ({_listed(moving)})",
            file=file,
            allowed=ALLOWED,
            fix="remove the joints, so that the parts are one body; a robot is imported by `oimppi scene robot`",
        )


def _only_body(file: Path, builder: newton.ModelBuilder) -> int:
    """Returns the number of the only body with colliding shapes; -1 if all of them belong to the world."""
    import newton

    colliding = int(newton.ShapeFlags.COLLIDE_SHAPES)
    owners = {
        int(owner)
        for owner, flags in zip(builder.shape_body, builder.shape_flags, strict=True)
        if int(flags) & colliding
    }
    bodies = sorted(owners - {-1})
    if len(bodies) > 1:
        names = [builder.body_label[body].rpartition("/")[2] for body in bodies]
        fix = "keep one of them, or put one inside the other without a joint"
        raise SceneError(f"the file has {len(bodies)} bodies ({_listed(names)})", file=file, allowed=ALLOWED, fix=fix)
    if not owners:
        raise SceneError(
            "nothing in the file collides",
            file=file,
            allowed=f"geoms that collide: {_SHAPES}, with contype or conaffinity above zero",
            fix="let its geoms collide, or import its mesh file instead",
        )
    return bodies[0] if bodies else -1


def _read_shapes(file: Path, builder: newton.ModelBuilder, body: int) -> _Body:
    """Reads the shapes of a body; raises SceneError for one that is not convex or not finite."""
    import newton

    found = _Body()
    for number, owner in enumerate(builder.shape_body):
        if int(owner) != body:
            continue
        flags, label = int(builder.shape_flags[number]), builder.shape_label[number].rpartition("/")[2]
        collides = bool(flags & int(newton.ShapeFlags.COLLIDE_SHAPES))
        mesh = _shape(builder, number)
        if mesh is None:
            if not collides or body < 0:  # the world's floor, for example
                continue
            kind = newton.GeoType(int(builder.shape_type[number])).name.lower()
            fix = f"replace the geom {label}, or remove it"
            raise SceneError(f"a geom is a {kind}", file=file, allowed=f"{_SHAPES}: solids that can move", fix=fix)
        if not collides:
            found.surfaces.append((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
            continue
        hull = limited_hull(mesh.vertices, CORNERS)
        found.hulls.append(hull)
        found.frictions.append(float(builder.shape_material_mu[number]))
        volume = trimesh.Trimesh(*hull).volume
        if mesh.is_watertight and abs(mesh.volume) < (1.0 - HOLLOW) * volume:
            found.hollow[label] = 1.0 - abs(float(mesh.volume)) / volume
            found.surfaces.append((np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    if not found.hulls:
        raise SceneError("no body in the file collides", file=file, allowed=ALLOWED, fix="add a <body> with geoms")
    return found


def _shape(builder: newton.ModelBuilder, number: int) -> trimesh.Trimesh | None:
    """Returns a shape as a mesh in its body's frame [m]; ``None`` for one without a volume, such as a plane."""
    import newton

    kinds = newton.GeoType
    kind, (a, b, c) = kinds(int(builder.shape_type[number])), map(float, builder.shape_scale[number])
    at = np.array(builder.shape_transform[number], dtype=float)
    if kind in (kinds.MESH, kinds.CONVEX_MESH):
        source = builder.shape_source[number]
        points = np.asarray(source.vertices, dtype=float) * (a, b, c)
        mesh = trimesh.Trimesh(points, np.asarray(source.indices).reshape(-1, 3))
    elif kind == kinds.ELLIPSOID:
        mesh = trimesh.creation.icosphere(2)
        mesh.apply_scale((a, b, c))
    elif kind == kinds.BOX:
        mesh = collider_mesh(Collider("", "box", _HERE, (a, b, c)))
    elif kind == kinds.SPHERE:
        mesh = collider_mesh(Collider("", "sphere", _HERE, (a,)))
    elif kind in (kinds.CAPSULE, kinds.CYLINDER):
        mesh = collider_mesh(Collider("", "capsule" if kind == kinds.CAPSULE else "cylinder", _HERE, (a, b)))
    else:
        return None
    x, y, z, *turn = at
    matrix = trimesh.transformations.quaternion_matrix([turn[3], *turn[:3]])
    matrix[:3, 3] = x, y, z
    mesh.apply_transform(matrix)
    return mesh


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
