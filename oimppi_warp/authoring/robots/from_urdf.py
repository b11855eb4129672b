"""Reads a robot from a URDF: its tree of links, and the same links in Newton's builder."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import networkx as nx

from oimppi_warp.authoring.robots.articulation import Articulation
from oimppi_warp.authoring.robots.chain import Chain, Kind, Limits, TreeJoint, serial_chain
from oimppi_warp.errors import SceneError

_KINDS: dict[str, Kind] = {
    "revolute": "turns",
    "continuous": "turns",
    "prismatic": "slides",
    "fixed": "fixed",
}
_GREY = '<material name=""><color rgba="0.855 0.86 0.871 1"/></material>'
"""Material for visuals without a colour."""


def read_urdf(file: Path, *, flange: str = "") -> tuple[Chain, Articulation]:
    """Reads the chain in a URDF, with the properties of its links and joints.

    Args:
        file: The URDF.
        flange: The link that carries the stick; other moving links are then ignored. Empty: the end of the only chain.

    Raises:
        SceneError: The file cannot be read, is not a tree of links, branches, has a joint that a planner cannot drive,
            or refers to a mesh that is missing.
    """
    root = _parse(file)
    chain = serial_chain(_tree(file, root), file=file, flange=flange)
    _resolve(file, root, {link for group in chain.groups for link, _ in group})
    import newton

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    try:
        builder.add_urdf(ET.tostring(root, encoding="unicode"))
    except Exception:  # mesh readers raise many kinds of exceptions
        for link in root.findall("link"):
            _remove(link, link.findall("visual"))  # visuals may be in formats that no reader here supports
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        try:
            builder.add_urdf(ET.tostring(root, encoding="unicode"))
        except Exception as error:
            raise SceneError(
                f"the robot cannot be read ({error})",
                file=file,
                allowed="a valid URDF, with collision meshes in STL, OBJ or PLY format",
                fix="correct the element that the reason concerns, or convert the meshes",
            ) from error
    bodies, joints = (
        {label.rpartition("/")[2]: index for index, label in enumerate(labels)}
        for labels in (builder.body_label, builder.joint_label)
    )
    return chain, Articulation(builder, bodies=bodies, joints=joints, file=file)


def _parse(file: Path) -> ET.Element:
    if not file.is_file():
        raise SceneError("there is no such file", file=file, allowed="a URDF")
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, UnicodeDecodeError, ValueError) as error:
        raise SceneError(f"the file cannot be read as XML ({error})", file=file, allowed="a URDF") from None
    if root.tag != "robot":
        raise SceneError(
            f"the root element is <{root.tag}>", file=file, allowed="a URDF, with the root element <robot>"
        )
    if any("ros.org/wiki/xacro" in str(element.tag) for element in root.iter()):
        fix = f"expand it: xacro {file.name} > {file.name.removesuffix('.xacro').removesuffix('.urdf')}.urdf"
        raise SceneError("the file is xacro, not URDF", file=file, allowed="a URDF without macros", fix=fix)
    return root


def _tree(file: Path, root: ET.Element) -> nx.DiGraph:
    """Builds a graph of the links and the joints between them."""
    tree = nx.DiGraph()
    tree.add_nodes_from(link.get("name", "") for link in root.findall("link"))
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        ends = [_named(joint, end) for end in ("parent", "child")]
        for link in ends:
            if link not in tree:
                raise SceneError(
                    f"joint {name} refers to a missing link {link!r}", file=file, allowed="links of the URDF"
                )
        if kind not in _KINDS:
            what = f"joint {name} between {ends[0]} and {ends[1]} is of type {kind or 'none'}"
            fix = "the base must be fixed" if kind in ("floating", "planar") else "correct its type"
            raise SceneError(what, file=file, allowed=", ".join(_KINDS), fix=fix)
        follows = joint.find("mimic") is not None
        tree.add_edge(*ends, joint=TreeJoint(name, _KINDS[kind], _limits(file, joint), follows))
    return tree


def _named(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _limits(file: Path, joint: ET.Element) -> Limits | None:
    """Returns a joint's limits, or ``None`` if required ones are missing."""
    limit, given = joint.find("limit"), dict[str, float]()
    for key in ("lower", "upper", "effort", "velocity"):
        text = None if limit is None else limit.get(key)
        try:
            given[key] = math.inf if text is None else float(text)
        except ValueError:
            what = f"joint {joint.get('name')}: {key} is {text!r}"
            raise SceneError(what, file=file, allowed="a number") from None
    if joint.get("type") == "continuous":
        given["lower"], given["upper"] = -math.inf, math.inf
    elif not (math.isfinite(given["lower"]) and math.isfinite(given["upper"])):
        return None
    return Limits(**given)


def _resolve(file: Path, root: ET.Element, members: set[str]) -> None:
    """Makes mesh paths absolute, and removes shapes of other links and visuals whose file is missing."""
    for link in root.findall("link"):
        if link.get("name") not in members:
            _remove(link, [*link.findall("visual"), *link.findall("collision")])
        for mesh in link.findall("collision/geometry/mesh"):
            name = mesh.get("filename", "")
            found = _mesh(file, name)
            if found is None:
                raise SceneError(
                    f"link {link.get('name')}: the collision mesh {name!r} does not exist",
                    file=file,
                    allowed="a path relative to the URDF file, or package://NAME/PATH with the package folder NAME "
                    "next to the URDF file or in a folder above it",
                    fix="add the file, or remove the <collision> element that names it",
                )
            mesh.set("filename", str(found))
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            found = None if mesh is None else _mesh(file, mesh.get("filename", ""))
            if mesh is not None and found is None:
                link.remove(visual)
            elif mesh is not None:
                mesh.set("filename", str(found))
            if visual.find("material") is None and (found is None or found.suffix.lower() == ".stl"):
                visual.append(ET.fromstring(_GREY))


def _remove(link: ET.Element, elements: list[ET.Element]) -> None:
    for element in elements:
        link.remove(element)


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
    return next((above / place for above in folders if name and (above / place).is_file()), None)
