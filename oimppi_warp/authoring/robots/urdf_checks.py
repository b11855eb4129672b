"""Finds plain mistakes in a URDF's XML, before an importer reads it; each message names the element."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import numpy as np

from oimppi_warp.errors import SceneError
from oimppi_warp.usd.stage import MAX_LENGTH

KINDS = ("revolute", "continuous", "prismatic", "fixed")
"""Types of joints that a robot may have."""
FLOATING = ("floating", "planar")
"""Types of joints that float: what they carry is left out."""
_SIZES = {
    "box": (("size", 3, ""),),
    "sphere": (("radius", 1, ""),),
    "cylinder": (("radius", 1, ""), ("length", 1, "")),
    "capsule": (("radius", 1, ""), ("length", 1, "")),
    "mesh": (("scale", 3, "1 1 1"),),
}
"""For each shape: its attributes with numbers, how many numbers, and their default (none: it is required)."""
_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def check_names(file: Path, root: ET.Element) -> None:
    """Checks that links and joints have names of their own, and that joints connect links that exist.

    Raises:
        SceneError: A name is missing or is used twice, or a joint has no parent, no child, an unknown type or link.
    """
    for kind in ("link", "joint"):
        names = [element.get("name", "") for element in root.findall(kind)]
        if "" in names:
            what = f"<{kind}> number {names.index('') + 1} has no name"
            raise SceneError(what, file=file, allowed="a name for each link and joint", fix=f"name the {kind}")
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            what = f"{len([n for n in names if n == twice[0]])} {kind}s have the name {twice[0]}"
            raise SceneError(what, file=file, allowed="a different name for each", fix=f"rename one of these {kind}s")
    links = {link.get("name", "") for link in root.findall("link")}
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        ends = [linked(joint, end) for end in ("parent", "child")]
        for end, link in zip(("parent", "child"), ends, strict=True):
            if not link:
                fix = f'add <{end} link="..."/> to it'
                raise SceneError(f"joint {name} has no {end}", file=file, allowed="a parent and a child link", fix=fix)
            if link not in links:
                raise SceneError(
                    f"joint {name} refers to a missing link {link!r}", file=file, allowed="links of the URDF"
                )
        if kind not in (*KINDS, *FLOATING):
            what = f"joint {name} between {ends[0]} and {ends[1]} is of type {kind or 'none'}"
            raise SceneError(what, file=file, allowed=", ".join(KINDS), fix="correct its type")


def linked(joint: ET.Element, end: str) -> str:
    """Returns the name of a joint's ``"parent"`` or ``"child"`` link; empty if there is none."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def check_joint(file: Path, joint: ET.Element) -> None:
    """Checks a joint's frame and axis.

    Raises:
        SceneError: They are no numbers, or the axis is zero.
    """
    owner = f"joint {joint.get('name')}"
    _check_origin(file, owner, joint)
    axis = joint.find("axis")
    if axis is None or joint.get("type") == "fixed":
        return
    values = _numbers(file, owner, axis, "xyz", 3, "1 0 0")
    if np.linalg.norm(values) < 1e-6:
        what = f"{owner}: the axis is {axis.get('xyz')}"
        raise SceneError(what, file=file, allowed="a direction, such as 0 0 1", fix="correct <axis>")


def check_shapes(file: Path, link: ET.Element, kind: str = "collision") -> None:
    """Checks the shapes of a link: ``kind`` is ``"collision"`` or ``"visual"``.

    Raises:
        SceneError: A shape has sizes that are not numbers above zero, or no shape is given.
    """
    owner = f"link {link.get('name')}"
    for element in link.findall(kind):
        _check_origin(file, f"{owner}: <{kind}>", element)
        shapes = element.findall("geometry/*")
        if len(shapes) != 1 or shapes[0].tag not in _SIZES:
            what = f"{owner}: <{kind}> has {' and '.join(f'<{shape.tag}>' for shape in shapes) or 'no shape'}"
            allowed = f"one of {', '.join(_SIZES)}"
            raise SceneError(what, file=file, allowed=allowed, fix=f"correct its <geometry>, or remove the <{kind}>")
        shape = shapes[0]
        for name, count, default in _SIZES[shape.tag]:
            values = _numbers(file, f"{owner}: <{shape.tag}>", shape, name, count, default)
            if (np.abs(values) if shape.tag == "mesh" else values).min() <= 0.0:
                what = f"{owner}: the {name} of its <{shape.tag}> is {shape.get(name)}"
                raise SceneError(what, file=file, allowed="more than zero", fix="correct it, or remove the shape")


def check_inertial(file: Path, link: ET.Element) -> None:
    """Checks that mass and inertia of a link are numbers.

    Raises:
        SceneError: They are not, or the mass is negative.
    """
    inertial, owner = link.find("inertial"), f"link {link.get('name')}"
    if inertial is None:
        return
    _check_origin(file, f"{owner}: <inertial>", inertial)
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is not None and _numbers(file, owner, mass, "value", 1, "0", word="mass")[0] < 0.0:
        raise SceneError(f"{owner}: the mass is {mass.get('value')}", file=file, allowed="a mass above zero [kg]")
    if inertia is not None:
        for name in _INERTIA:
            _numbers(file, owner, inertia, name, 1, "0")


def _check_origin(file: Path, owner: str, element: ET.Element) -> None:
    origin = element.find("origin")
    if origin is not None:
        _numbers(file, owner, origin, "xyz", 3, "0 0 0")
        _numbers(file, owner, origin, "rpy", 3, "0 0 0")


def _numbers(
    file: Path, owner: str, element: ET.Element, name: str, count: int, default: str = "", *, word: str = ""
) -> np.ndarray:
    """Returns the numbers in an attribute, shape [count].

    Raises:
        SceneError: There are others than ``count`` finite numbers below :data:`.MAX_LENGTH`.
    """
    text = element.get(name, "").strip() or default
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.abs(values) < MAX_LENGTH).all():
        allowed = f"{count} numbers" if count > 1 else "a number"
        what = f"{owner}: {word or name} is {text!r}" if text else f"{owner} has no {word or name}"
        fix = f"correct {name} of its <{element.tag}>"
        raise SceneError(what, file=file, allowed=f"{allowed}, finite and below {MAX_LENGTH:g}", fix=fix)
    return values


def number(text: str | None) -> float:
    """Returns the number in a limit's text: infinite without a text or from a million on, NaN if it is no number."""
    try:
        value = math.inf if text is None else float(text)
    except ValueError:
        return math.nan
    return math.copysign(math.inf, value) if abs(value) >= 1e6 else value
