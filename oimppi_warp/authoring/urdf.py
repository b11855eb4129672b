"""The serial chain in a URDF: which joints move the flange, what is fixed to each link, and what stands in the way."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import networkx as nx

from oimppi_warp.errors import SceneError

_TURNS, _SLIDES = ("revolute", "continuous"), ("prismatic",)
_MOVES = (*_TURNS, *_SLIDES)


@dataclass(frozen=True)
class Chain:
    """A serial chain from a URDF's root to its flange, by the names of links and joints.

    Attributes:
        file: The URDF.
        name: The robot's name in it.
        joints: The moving joints, from base to flange.
        groups: For the base, and for the link that each joint moves: that link, then all that is fixed to it, each with
            the joint that fixes it (none for the first).
        flange: The link that carries the stick.
        limits: Limits of each joint as far as they are given: lower, upper, effort, velocity.
        text: The URDF without what is only looked at, its meshes by their whole paths.
    """

    file: Path
    name: str
    joints: tuple[str, ...]
    groups: tuple[tuple[tuple[str, str], ...], ...]
    flange: str
    limits: tuple[dict[str, float], ...]
    text: str


def read_chain(file: Path, *, flange: str = "") -> Chain:
    """The chain in a URDF.

    Args:
        file: The URDF.
        flange: The link that carries the stick; what else moves is left out then. None: the end of the only chain.

    Raises:
        SceneError: It cannot be read, is no tree of links, branches, or has a joint that a planner cannot drive.
    """
    root = _parse(file)
    tree = _tree(file, root)
    base = next(link for link in tree if tree.in_degree(link) == 0)
    if flange and flange not in tree:
        raise SceneError(f"--flange {flange}: no such link", file=file, allowed=", ".join(tree))
    path = _path(file, tree, base, flange)
    moving = [(a, b) for a, b in pairwise(path) if tree.edges[a, b]["kind"] in _MOVES]
    if not moving:
        raise SceneError("a robot without moving joints", file=file, allowed="a chain of them from base to flange")
    groups = tuple(tuple(_fixed_to(tree, link)) for link in [base, *(child for _, child in moving)])
    _resolve(file, root, {link for group in groups for link, _ in group})
    return Chain(
        file=file,
        name=root.get("name") or file.stem,
        joints=tuple(tree.edges[edge]["name"] for edge in moving),
        groups=groups,
        flange=flange or _flange(tree, groups[-1]),
        limits=tuple(_limits(file, tree.edges[edge]["element"]) for edge in moving),
        text=ET.tostring(root, encoding="unicode"),
    )


def _parse(file: Path) -> ET.Element:
    if not file.is_file():
        raise SceneError("there is no such file", file=file, allowed="a URDF")
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, UnicodeDecodeError, ValueError) as error:
        raise SceneError(f"not XML that can be read ({error})", file=file, allowed="a URDF") from None
    if root.tag != "robot":
        raise SceneError(f"its root is <{root.tag}>", file=file, allowed="a URDF, whose root is <robot>")
    if any("ros.org/wiki/xacro" in str(element.tag) for element in root.iter()):
        fix = f"expand it: xacro {file.name} > {file.name.removesuffix('.xacro').removesuffix('.urdf')}.urdf"
        raise SceneError("xacro, not URDF", file=file, allowed="a URDF without macros", fix=fix)
    return root


def _resolve(file: Path, root: ET.Element, members: set[str]) -> None:
    """Leave out what is only looked at and the shapes of other links, and give the meshes their whole paths."""
    for link in root.findall("link"):
        gone = [] if link.get("name") in members else link.findall("collision")
        for element in (*link.findall("visual"), *gone):
            link.remove(element)
        for mesh in link.findall("collision/geometry/mesh"):
            mesh.set("filename", str(_mesh(file, mesh.get("filename", ""))))


def _mesh(file: Path, name: str) -> Path:
    """The file of a mesh: a path beside the URDF, or package://NAME/ for a folder NAME beside it or above it."""
    folder = file.resolve().parent
    place = name.removeprefix("package://").removeprefix("file://")
    folders = (folder, *folder.parents) if name.startswith("package://") else (folder,)
    found = next((above / place for above in folders if name and (above / place).is_file()), None)
    if found is None:
        raise SceneError(
            f"the mesh {name!r} is not there",
            file=file,
            allowed="a path beside it, or package://NAME/ for a folder NAME beside it or above it",
            fix="put it there, or take its <collision> out",
        )
    return found


def _tree(file: Path, root: ET.Element) -> nx.DiGraph:
    """Links and the joints between them."""
    tree = nx.DiGraph()
    tree.add_nodes_from(link.get("name", "") for link in root.findall("link"))
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        ends = [_named(joint, end) for end in ("parent", "child")]
        for link in ends:
            if link not in tree:
                raise SceneError(f"joint {name} at a link {link!r} that is not there", file=file, allowed="its links")
        if tree.in_degree(ends[1]):
            raise SceneError(f"link {ends[1]} has two joints before it", file=file, allowed="a tree of links")
        tree.add_edge(*ends, name=name, kind=kind, element=joint)
    bases = [link for link in tree if tree.in_degree(link) == 0]
    if not len(tree) or not nx.is_directed_acyclic_graph(tree):
        raise SceneError("links that hold each other in a circle, or none at all", file=file, allowed="a tree of links")
    if len(bases) > 1:
        what = f"{len(bases)} links that nothing holds: {', '.join(bases)}"
        raise SceneError(what, file=file, allowed="one base", fix="join the others to it, or remove them")
    return tree


def _named(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _path(file: Path, tree: nx.DiGraph, base: str, flange: str) -> list[str]:
    """Links from the base to the flange, or to the last link that moves."""
    for a, b, edge in tree.edges(data=True):
        if edge["kind"] not in (*_MOVES, "fixed"):
            what = f"joint {edge['name']} of type {edge['kind'] or 'none'}, between {a} and {b}"
            fix = "the base must be fixed" if edge["kind"] in ("floating", "planar") else "correct its type"
            raise SceneError(what, file=file, allowed="revolute, continuous, prismatic, fixed", fix=fix)
    moved = [b for _, b, kind in tree.edges(data="kind") if kind in _MOVES]
    ends = [link for link in moved if not any(other in moved for other in nx.descendants(tree, link))]
    if not flange and len(ends) > 1:
        raise SceneError(
            f"the arm branches: {' and '.join(ends)} move on their own",
            file=file,
            allowed="a serial arm",
            fix="say with --flange which link carries the stick; what else moves is left out",
        )
    end = flange or (ends[0] if ends else base)
    path = nx.shortest_path(tree, base, end)
    for a, b in pairwise(path):
        if tree.edges[a, b]["element"].find("mimic") is not None:
            what = f"joint {tree.edges[a, b]['name']} moves with another (mimic)"
            raise SceneError(what, file=file, allowed="joints that are driven by themselves", fix="make it fixed")
    return path


def _fixed_to(tree: nx.DiGraph, link: str) -> Iterator[tuple[str, str]]:
    """A link and all that is fixed to it, with the joints that fix them, parents first."""
    yield link, ""
    for _, child, edge in tree.out_edges(link, data=True):
        if edge["kind"] == "fixed":
            for member, joint in _fixed_to(tree, child):
                yield member, joint or edge["name"]


def _flange(tree: nx.DiGraph, group: tuple[tuple[str, str], ...]) -> str:
    """The end of the links fixed to the last one that moves; that one itself, where they branch."""
    ends = [link for link, _ in group if not tree.out_degree(link)]
    return ends[0] if len(ends) == 1 else group[0][0]


def _limits(file: Path, joint: ET.Element) -> dict[str, float]:
    """What a joint's limits say; infinite, where they say nothing and may do so."""
    name, kind, limit = joint.get("name", ""), joint.get("type"), joint.find("limit")
    given: dict[str, float] = {}
    for key in ("lower", "upper", "effort", "velocity"):
        text = None if limit is None else limit.get(key)
        try:
            given[key] = math.inf if text is None else float(text)
        except ValueError:
            raise SceneError(f"joint {name}: {key} = {text!r}", file=file, allowed="a number") from None
    unit, fix = ("m", "") if kind in _SLIDES else ("rad", "a joint that turns without end is of type continuous")
    if kind == "continuous":
        given["lower"], given["upper"] = -math.inf, math.inf
    elif limit is None or not (math.isfinite(given["lower"]) and math.isfinite(given["upper"])):
        allowed = f"<limit lower upper effort velocity> in {unit}"
        raise SceneError(f"joint {name} has no limits", file=file, allowed=allowed, fix=fix)
    elif not given["lower"] < given["upper"]:
        what = f"joint {name}: limits of {given['lower']:g} and {given['upper']:g} {unit}"
        raise SceneError(what, file=file, allowed="lower below upper")
    if not (given["effort"] > 0.0 and given["velocity"] > 0.0):
        what = f"joint {name}: effort {given['effort']:g} and velocity {given['velocity']:g}"
        fix = "give what the arm can do; left out, they are unlimited"
        raise SceneError(what, file=file, allowed="more than zero", fix=fix)
    return given
