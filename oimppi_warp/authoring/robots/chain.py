"""Finds the serial chain in a tree of links: the joints that move the flange, and the parts fixed to each link."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import networkx as nx

from oimppi_warp.errors import SceneError

Kind = Literal["turns", "slides", "fixed"]
_FAST = 50.0
"""Velocity above which the limits of a joint that turns far are taken to be in degrees [rad/s]."""
_SLOW_TURN, _SLOW_SLIDE = 0.05, 0.005
"""Velocities below which one asks for the unit of a joint's velocity limit [rad/s, m/s]."""


@dataclass(frozen=True)
class Limits:
    """Limits of a joint; infinite where not specified.

    Attributes:
        lower, upper: Position limits [rad; m for a prismatic joint].
        effort: Effort limit [N m; N for a prismatic joint].
        velocity: Velocity limit [rad/s; m/s for a prismatic joint].
    """

    lower: float
    upper: float
    effort: float
    velocity: float


@dataclass(frozen=True)
class TreeJoint:
    """A joint in the tree of links.

    Attributes:
        name: Name of the joint.
        kind: Motion that the joint allows: ``"turns"``, ``"slides"`` or ``"fixed"``.
        limits: Limits of the joint; ``None`` for a fixed joint, or if required limits are missing.
        follows: Whether the joint follows another one (mimic).
        losses: Whether the joint has friction or damping.
        mistake: Mistake that keeps the joint from being driven; it does not matter if the joint is left out.
    """

    name: str
    kind: Kind
    limits: Limits | None = None
    follows: bool = False
    losses: bool = False
    mistake: SceneError | None = None


@dataclass(frozen=True)
class Chain:
    """A serial chain from a base to its flange, by link and joint names.

    Attributes:
        joints: Names of the moving joints, from base to flange.
        groups: For the base, and for the link moved by each joint: that link, then everything fixed to it, each with
            the joint that fixes it (none for the first).
        flange: Name of the link that carries the stick.
        limits: Limits of each moving joint.
        kinds: Motion of each moving joint.
        notes: What the user should know about how the file was read, a line each.
    """

    joints: tuple[str, ...]
    groups: tuple[tuple[tuple[str, str], ...], ...]
    flange: str
    limits: tuple[Limits, ...]
    kinds: tuple[Kind, ...]
    notes: tuple[str, ...] = ()

    @property
    def links(self) -> tuple[str, ...]:
        """Returns the name of the link that each joint moves."""
        return tuple(group[0][0] for group in self.groups[1:])


def short_name(name: str) -> str:
    """Returns the name of a link or a joint as it is printed: of a prim's path, the last part."""
    return name.rpartition("/")[2] if name.startswith("/") else name


def serial_chain(tree: nx.DiGraph, *, file: Path, flange: str = "") -> Chain:
    """Extracts the chain from a tree whose edges carry a :class:`TreeJoint` as ``joint``, and which may have ``notes``.

    Args:
        tree: Links, with an edge from each parent to each child.
        file: Path of the source file, for error messages.
        flange: The link that carries the stick; moving links beyond or beside its chain are then left out. Empty: the
            end of the only chain.

    Raises:
        SceneError: The graph is not a tree, has no moving joint or no link ``flange``, branches although no flange is
            given, or has a joint that a planner cannot drive.
    """
    base = _base(tree, file)
    if flange and flange not in tree:
        raise SceneError(f"--flange {flange}: the robot has no such link", file=file, allowed=", ".join(tree))
    path = _path(tree, base, flange, file)
    moving = [joint for joint in pairwise(path) if _joint(tree, *joint).kind != "fixed"]
    if not moving:
        raise SceneError(
            "the robot has no moving joints",
            file=file,
            allowed="a chain of moving joints from base to flange",
            fix="join its links by revolute or prismatic joints; with --flange, name a link that moves",
        )
    groups = tuple(tuple(_fixed_to(tree, link)) for link in [base, *(child for _, child in moving)])
    joints = [_joint(tree, *ends) for ends in moving]
    return Chain(
        joints=tuple(joint.name for joint in joints),
        groups=groups,
        flange=flange or _flange(tree, groups[-1]),
        limits=tuple(_checked(joint, file) for joint in joints),
        kinds=tuple(joint.kind for joint in joints),
        notes=(
            *tree.graph.get("notes", ()),
            *_losses(joints),
            *_slow(joints),
            *([] if flange else _finger(groups, joints, moving[-1][0])),
        ),
    )


def _slow(joints: list[TreeJoint]) -> Iterator[str]:
    """Yields a note for joints that are so slow that their velocity limits are likely to be in another unit."""
    for joint in joints:
        slowest, unit = (_SLOW_SLIDE, "m/s") if joint.kind == "slides" else (_SLOW_TURN, "rad/s")
        if joint.limits is not None and 0.0 < joint.limits.velocity < slowest:
            yield f"warning: joint {joint.name} moves at {joint.limits.velocity:.3g} {unit} at most; is that its unit?"


def _losses(joints: list[TreeJoint]) -> Iterator[str]:
    """Yields a note if joints have friction or damping, which the robot does not get."""
    lossy = ", ".join(short_name(joint.name) for joint in joints if joint.losses)
    if lossy:
        yield f"left out: friction and damping of {lossy}; the drives of a real arm make up for them"


def _finger(groups: tuple[tuple[tuple[str, str], ...], ...], joints: list[TreeJoint], holder: str) -> Iterator[str]:
    """Yields a note if the last joint is probably a gripper's: it slides, beyond a link that is fixed to another."""
    slides = [joint.kind == "slides" for joint in joints]
    if len(joints) > 3 and slides[-1] and not any(slides[:-1]) and holder != groups[-2][0][0]:
        finger, name = short_name(joints[-1].name), short_name(holder)
        yield f"joint {finger} carries the stick; if it is that of a gripper, leave it out with --flange {name}"


def _joint(tree: nx.DiGraph, parent: str, child: str) -> TreeJoint:
    return tree.edges[parent, child]["joint"]


def _base(tree: nx.DiGraph, file: Path) -> str:
    """Returns the root link, which has no parent."""
    if not tree:
        raise SceneError("the file has no links", file=file, allowed="a tree of links", fix="add the robot's links")
    for link in tree:
        if tree.in_degree(link) > 1:
            holding = [_joint(tree, parent, link).name for parent in tree.predecessors(link)]
            what = f"link {link} has {len(holding)} parent joints: {', '.join(holding)}"
            raise SceneError(what, file=file, allowed="a tree of links", fix="keep only one of these joints")
    bases = [link for link in tree if tree.in_degree(link) == 0]
    if not nx.is_directed_acyclic_graph(tree):
        loop = [(parent, child) for parent, child, *_ in nx.find_cycle(tree)]
        joints = ", ".join(_joint(tree, *ends).name for ends in loop)
        what = f"the links {', '.join(parent for parent, _ in loop)} form a loop"
        raise SceneError(what, file=file, allowed="a tree of links", fix=f"remove one of the joints: {joints}")
    if len(bases) > 1:
        what = f"{len(bases)} links have no parent: {', '.join(bases)}"
        raise SceneError(what, file=file, allowed="one base", fix="connect the others to it, or remove them")
    return bases[0]


def _path(tree: nx.DiGraph, base: str, flange: str, file: Path) -> list[str]:
    """Returns the links from the base to the flange, or to the last moving link."""
    moved = [child for parent, child in tree.edges if _joint(tree, parent, child).kind != "fixed"]
    ends = [link for link in moved if not any(other in moved for other in nx.descendants(tree, link))]
    if not flange and len(ends) > 1:
        raise SceneError(
            f"the arm branches: {' and '.join(ends)} move independently",
            file=file,
            allowed="a serial arm",
            fix="name the link that carries the stick with --flange; other branches are left out",
        )
    path = nx.shortest_path(tree, base, flange or (ends[0] if ends else base))
    for ends in pairwise(path):
        if _joint(tree, *ends).follows:
            what = f"joint {_joint(tree, *ends).name} follows another joint (mimic)"
            fix = "the planner cannot drive it: use another robot, or make the joint fixed if it never moves"
            raise SceneError(what, file=file, allowed="joints that are driven independently", fix=fix)
    return path


def _fixed_to(tree: nx.DiGraph, link: str) -> Iterator[tuple[str, str]]:
    """Yields a link and everything fixed to it, with the joints that fix them, parents first."""
    yield link, ""
    for child in tree.successors(link):
        joint = _joint(tree, link, child)
        if joint.kind == "fixed":
            for member, name in _fixed_to(tree, child):
                yield member, name or joint.name


def _flange(tree: nx.DiGraph, group: tuple[tuple[str, str], ...]) -> str:
    """Returns the end of the links fixed to the last moving one, or that link itself if they branch."""
    ends = [link for link, _ in group if not tree.out_degree(link)]
    return ends[0] if len(ends) == 1 else group[0][0]


def _checked(joint: TreeJoint, file: Path) -> Limits:
    """Checks that a joint can be driven within its limits, and returns them."""
    if joint.mistake is not None:
        raise joint.mistake
    limits = joint.limits
    unit, force = ("m", "N") if joint.kind == "slides" else ("rad", "N m")
    if limits is None or (joint.kind == "slides" and not abs(limits.upper - limits.lower) < float("inf")):
        endless = "" if joint.kind == "slides" else "; for a joint that turns without limits, use the type continuous"
        allowed = f"a lower and an upper limit [{unit}]"
        raise SceneError(f"joint {joint.name} has no limits", file=file, allowed=allowed, fix=f"set both{endless}")
    if not limits.lower < limits.upper:
        lower, upper = (_angle_or_length(value, unit) for value in (limits.lower, limits.upper))
        what = f"joint {joint.name}: the lower limit ({lower}) is not below the upper limit ({upper})"
        raise SceneError(what, file=file, allowed="a lower limit below the upper one", fix="correct the limits")
    turns = [abs(value) for value in (limits.lower, limits.upper) if math.isfinite(value)]
    if joint.kind == "turns" and turns and max(turns) > 4.0 * math.pi and _FAST < limits.velocity < math.inf:
        what = f"joint {joint.name} turns to {max(turns):.4g} rad, at up to {limits.velocity:.4g} rad/s"
        fix = "are its limits in degrees? give them in radians"
        raise SceneError(what, file=file, allowed=f"two turns, or at most {_FAST:g} rad/s", fix=fix)
    if not (limits.effort > 0.0 and limits.velocity > 0.0):
        degrees = f" ({math.degrees(limits.velocity):.4g} deg/s)" if unit == "rad" else ""
        effort, velocity = f"{limits.effort:g} {force}", f"{limits.velocity:.4g} {unit}/s{degrees}"
        what = f"joint {joint.name}: the effort limit is {effort} and the velocity limit is {velocity}"
        fix = "set the joint's real limits; a limit that is left out is infinite"
        raise SceneError(what, file=file, allowed="both more than zero", fix=fix)
    return limits


def _angle_or_length(value: float, unit: str) -> str:
    """Formats a position [rad or m]; an angle in degrees too, as USD files have it."""
    return f"{value:.4g} rad, {math.degrees(value):.4g} deg" if unit == "rad" else f"{value:.4g} m"
