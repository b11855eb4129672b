"""Reads a robot from a URDF: its tree of links, and the links of its chain in Newton's builder."""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import networkx as nx
import numpy as np

from oimppi_warp.authoring.robots.articulation import Articulation
from oimppi_warp.authoring.robots.chain import Chain, Kind, Limits, TreeJoint, serial_chain
from oimppi_warp.authoring.robots.urdf_checks import (
    FLOATING,
    KINDS,
    check_inertial,
    check_joint,
    check_names,
    check_shapes,
    linked,
    number,
)
from oimppi_warp.errors import SceneError

if TYPE_CHECKING:
    import newton

_KINDS: dict[str, Kind] = {
    "revolute": "turns",
    "continuous": "turns",
    "prismatic": "slides",
    "fixed": "fixed",
}
_GREY = '<material name=""><color rgba="0.855 0.86 0.871 1"/></material>'
"""Material for visuals without a colour."""
_SUPPOSED_DENSITY = 1000.0
"""Density of the shapes of a link for which the file gives no mass, that of water [kg/m^3]."""
_MESHES = "collision meshes in STL, OBJ or PLY format"


def read_urdf(file: Path, *, flange: str = "") -> tuple[Chain, Articulation]:
    """Reads the chain in a URDF, with the properties of its links and joints.

    Only what belongs to the chain has to be right: a mistake in a link or a joint that is left out does not matter, nor
    do the mass and the inertia of the base, which is fixed.

    Args:
        file: The URDF.
        flange: The link that carries the stick; other moving links are then ignored. Empty: the end of the only chain.

    Raises:
        SceneError: The file cannot be read, is not a tree of links, branches, has a joint that a planner cannot drive,
            or refers to a mesh that is missing.
    """
    root = _parse(file)
    check_names(file, root)
    chain = serial_chain(_tree(file, root), file=file, flange=flange)
    members = [link for group in chain.groups for link, _ in group]
    joints = [*chain.joints, *(joint for group in chain.groups for _, joint in group if joint)]
    reduced = _reduced(file, root, members, joints, base={link for link, _ in chain.groups[0]})
    builder = _built(file, reduced)
    bodies, found = (
        {names[int(label[1:])]: index for index, label in enumerate(labels) if label[1:].isdecimal()}
        for names, labels in ((members, builder.body_label), (joints, builder.joint_label))
    )
    weightless = [group for group in chain.groups[1:] if not any(builder.body_mass[bodies[link]] for link, _ in group)]
    if weightless:
        supposed = _built(file, reduced, density=_SUPPOSED_DENSITY)
        for body in (bodies[link] for group in weightless for link, _ in group):
            builder.body_mass[body] = supposed.body_mass[body]
            builder.body_com[body] = supposed.body_com[body]
            builder.body_inertia[body] = supposed.body_inertia[body]
        notes = [_supposed_mass(group, builder, bodies) for group in weightless]
        chain = replace(chain, notes=(*chain.notes, *filter(None, notes)))
    return chain, Articulation(builder, bodies=bodies, joints=found, file=file)


def _built(file: Path, robot: ET.Element, *, density: float = 0.0) -> newton.ModelBuilder:
    """Reads a robot into a builder, in which shapes have a density [kg/m^3].

    Raises:
        SceneError: It cannot be read.
    """
    import newton

    for last in (False, True):
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        builder.default_shape_cfg.density = density
        try:
            builder.add_urdf(ET.tostring(robot, encoding="unicode"))
        except Exception as error:  # mesh readers raise many kinds of exceptions
            if last:
                raise SceneError(
                    f"the robot cannot be read ({error})",
                    file=file,
                    allowed=f"a valid URDF, with {_MESHES}",
                    fix="correct the element that the reason concerns, or convert the meshes",
                ) from error
            for link in robot.findall("link"):
                _remove(link, link.findall("visual"))  # visuals may be in formats that no reader here supports
        else:
            return builder
    raise AssertionError


def _supposed_mass(group: tuple[tuple[str, str], ...], builder: newton.ModelBuilder, bodies: dict[str, int]) -> str:
    """Returns a note about the mass that a link is supposed to have; empty if it has no shapes either."""
    mass = sum(float(builder.body_mass[bodies[link]]) for link, _ in group)
    return f"link {group[0][0]} has no mass in the file: taken as {mass:.2g} kg, of its shapes" if mass else ""


def _parse(file: Path) -> ET.Element:
    if not file.is_file():
        raise SceneError("there is no such file", file=file, allowed="a URDF")
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, LookupError, ValueError) as error:
        raise SceneError(f"the file cannot be read as XML ({error})", file=file, allowed="a URDF") from None
    if root.tag != "robot":
        raise SceneError(
            f"the root element is <{root.tag}>", file=file, allowed="a URDF, with the root element <robot>"
        )
    if any("ros.org/wiki/xacro" in str(element.tag) for element in root.iter()):
        stem = file.name.removesuffix(".xacro").removesuffix(".urdf")
        fix = f"expand it: xacro {file.name} > {stem}_expanded.urdf"
        raise SceneError("the file is xacro, not URDF", file=file, allowed="a URDF without macros", fix=fix)
    return root


def _tree(file: Path, root: ET.Element) -> nx.DiGraph:
    """Builds a graph of the links and the joints between them, without what floats."""
    tree = nx.DiGraph()
    tree.add_nodes_from(link.get("name", "") for link in root.findall("link"))
    floating = [joint for joint in root.findall("joint") if joint.get("type") in FLOATING]
    for joint in root.findall("joint"):
        if joint in floating:
            continue
        name, ends = joint.get("name", ""), (linked(joint, "parent"), linked(joint, "child"))
        if tree.has_edge(*ends):
            what = f"link {ends[1]} has 2 parent joints: {tree.edges[ends]['joint'].name}, {name}"
            raise SceneError(what, file=file, allowed="a tree of links", fix="keep only one of these joints")
        limits, mistake = _limits(file, joint)
        follows = joint.find("mimic") is not None
        kind = _KINDS[joint.get("type", "")]
        tree.add_edge(*ends, joint=TreeJoint(name, kind, limits, follows, _has_losses(joint), mistake))
    for joint in floating:
        _leave_out(file, tree, joint)
    return tree


def _leave_out(file: Path, tree: nx.DiGraph, floating: ET.Element) -> None:
    """Removes what a floating joint carries from a tree, and adds a note about it.

    Raises:
        SceneError: It carries the arm, or a part of it.
    """
    parent, child = (linked(floating, end) for end in ("parent", "child"))
    carried = {child, *nx.descendants(tree, child)} if child in tree else set()
    moving = {child for _, child, edge in tree.edges(data=True) if edge["joint"].kind != "fixed"}
    name, kind = floating.get("name"), floating.get("type")
    if moving & carried or not moving:
        fix = "the base must be fixed" if not tree.in_degree(parent) else "replace it by revolute or prismatic joints"
        what = f"joint {name} between {parent} and {child} is of type {kind}"
        raise SceneError(what, file=file, allowed=", ".join(KINDS), fix=fix)
    tree.remove_nodes_from(carried)
    tree.graph.setdefault("notes", []).append(f"left out: link {child}, on joint {name} of type {kind}")


def _has_losses(joint: ET.Element) -> bool:
    """Returns whether a joint has friction or damping."""
    dynamics = joint.find("dynamics")
    return dynamics is not None and any(number(dynamics.get(name, "0")) != 0.0 for name in ("friction", "damping"))


def _limits(file: Path, joint: ET.Element) -> tuple[Limits | None, SceneError | None]:
    """Returns a joint's limits, ``None`` if required ones are missing, and the mistake in them, if there is one."""
    limit = joint.find("limit")
    texts = {key: None if limit is None else limit.get(key) for key in ("lower", "upper", "effort", "velocity")}
    given = {key: number(text) for key, text in texts.items()}
    if joint.get("type") == "continuous":
        given["lower"], given["upper"] = -math.inf, math.inf
    for key, value in given.items():
        if math.isnan(value):
            what = f"joint {joint.get('name')}: {key} is {texts[key]!r}"
            return None, SceneError(what, file=file, allowed="a number", fix="correct its <limit>")
    if joint.get("type") == "continuous" or (math.isfinite(given["lower"]) and math.isfinite(given["upper"])):
        return Limits(**given), None
    if texts["lower"] is not None and texts["upper"] is not None and joint.get("type") == "revolute":
        what = f"joint {joint.get('name')}: the limits {texts['lower']} and {texts['upper']} are no limits"
        fix = "set the joint's real limits; for a joint that turns without limits, use the type continuous"
        return None, SceneError(what, file=file, allowed="a lower and an upper limit [rad]", fix=fix)
    return None, None


def _reduced(file: Path, root: ET.Element, members: list[str], joints: list[str], *, base: set[str]) -> ET.Element:
    """Returns a URDF of the chain alone, checked, with absolute mesh paths, and numbers for the names of links, joints.

    Args:
        file: The URDF.
        root: Its root element.
        members: The links, each with its number as the new name, after an ``l``.
        joints: The joints between them, likewise after a ``j``.
        base: The links that do not move.
    """
    reduced = ET.Element("robot")
    reduced.extend(copy.deepcopy(material) for material in root.findall("material"))
    _remove_bad_colors(reduced)
    for joint in root.findall("joint"):
        if joint.get("name") not in joints:
            continue
        check_joint(file, joint)
        made = ET.SubElement(
            reduced, "joint", name=f"j{joints.index(joint.get('name', ''))}", type=joint.get("type", "")
        )
        for end in ("parent", "child"):
            ET.SubElement(made, end, link=f"l{members.index(linked(joint, end))}")
        made.extend(element for element in (joint.find("origin"), joint.find("axis")) if element is not None)
    for link in root.findall("link"):
        if link.get("name") in members:
            made = copy.deepcopy(link)
            _check_link(file, made, fixed=link.get("name") in base)
            made.set("name", f"l{members.index(link.get('name', ''))}")
            reduced.append(made)
    return reduced


def _check_link(file: Path, link: ET.Element, *, fixed: bool) -> None:
    """Checks a link, makes its mesh paths absolute, and removes visuals that cannot be drawn."""
    for capsule in link.findall("*/geometry/capsule"):  # named in two ways; Newton knows the second
        size = capsule.get("length") or capsule.get("height") or ""
        capsule.attrib.update(length=size, height=size)
    check_shapes(file, link)
    try:
        check_inertial(file, link)
    except SceneError:
        if not fixed:
            raise
        _remove(link, link.findall("inertial"))  # of a fixed base, it does not matter
    for mesh in link.findall("collision/geometry/mesh"):
        mesh.set("filename", str(_collision_mesh(file, link.get("name", ""), mesh.get("filename", ""))))
    for visual in link.findall("visual"):
        _remove_bad_colors(visual)
        mesh = visual.find("geometry/mesh")
        found = None if mesh is None else _mesh(file, mesh.get("filename", ""))
        if mesh is not None:
            mesh.set("filename", str(found))
        if (mesh is not None and found is None) or not _is_sound(file, link, visual):
            link.remove(visual)
        elif visual.find("material") is None and (found is None or found.suffix.lower() == ".stl"):
            visual.append(ET.fromstring(_GREY))


def _is_sound(file: Path, link: ET.Element, visual: ET.Element) -> bool:
    """Returns whether a visual's numbers can be used."""
    alone = ET.Element("link", name=link.get("name", ""))
    alone.append(visual)
    try:
        check_shapes(file, alone, "visual")
    except SceneError:
        return False
    return True


def _remove_bad_colors(element: ET.Element) -> None:
    """Removes the colours of materials that are not four numbers."""
    for material in element.findall("material"):
        for color in material.findall("color"):
            values = [number(value) for value in color.get("rgba", "").split()]
            if len(values) != 4 or not np.isfinite(values).all():
                material.remove(color)


def _remove(link: ET.Element, elements: list[ET.Element]) -> None:
    for element in elements:
        link.remove(element)


def _collision_mesh(file: Path, link: str, name: str) -> Path:
    """Returns the file of a collision mesh, which can be read and is not empty."""
    import trimesh

    found = _mesh(file, name)
    if found is None:
        raise SceneError(
            f"link {link}: the collision mesh {name!r} does not exist",
            file=file,
            allowed="a path relative to the URDF file, or package://NAME/PATH with the package folder NAME "
            "next to the URDF file or in a folder above it",
            fix="add the file, or remove the <collision> element that names it",
        )
    try:
        faces = trimesh.load_mesh(found).triangles
    except Exception as error:  # mesh readers raise many kinds of exceptions
        what = f"link {link}: the collision mesh {name!r} cannot be read ({error or type(error).__name__})"
        raise SceneError(what, file=file, allowed=_MESHES, fix="convert the mesh") from None
    if not len(faces) or not np.isfinite(faces).all():
        what = f"link {link}: the collision mesh {name!r} is {'empty' if not len(faces) else 'not finite'}"
        fix = "export the mesh again, or remove the <collision> element that names it"
        raise SceneError(what, file=file, allowed="a solid mesh", fix=fix)
    return found


def _mesh(file: Path, name: str) -> Path | None:
    """Finds the file of a mesh; returns ``None`` if it does not exist.

    Args:
        file: The URDF file.
        name: A path relative to the URDF file, or package://NAME/PATH with the folder NAME next to it or in a folder
            above it.
    """
    folder = file.resolve().parent
    place = name.removeprefix("package://").removeprefix("file://")
    folders = (folder, *folder.parents) if name.startswith("package://") else (folder,)
    try:
        return next((above / place for above in folders if place and (above / place).is_file()), None)
    except (OSError, ValueError):  # a name that is too long, or no name of a file
        return None
