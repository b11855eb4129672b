"""Parses objects and obstacles from command-line specs: ``letter:S``, ``box:0.1x0.06x0.05@0.5,0.1``."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from oimppi_warp.authoring.meshes.pose import Lay
from oimppi_warp.authoring.named_shapes import (
    COMMON_OPTIONS,
    Arguments,
    Shape,
    objects,
    prim_name,
    shapes_taking,
)
from oimppi_warp.authoring.objects.flat_object import Pushable
from oimppi_warp.authoring.objects.stored import ENDINGS, is_object_file, read_object
from oimppi_warp.authoring.task import Obstacle, Pose, StaticObject
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import SHAPES
from oimppi_warp.runtime.request import POSE, parse_pose

_PLACED = "OBJECT@X,Y[,YAW] in metres and radians"


@dataclass(frozen=True)
class ShapeOptions:
    """Options for making an object, beyond those in its spec.

    Attributes:
        mass: Mass [kg]; ``None``: a shipped or stored object's own, otherwise that of wood of the same volume.
        friction: Coulomb coefficient with the table; ``None``: a shipped or stored object's own, otherwise 0.4.
        height: Thickness of letters and words [m]; ``None``: 0.05.
        size: Height of a capital letter in its plane [m]; ``None``: 0.103, or less if a long word requires it.
        font: Name of an installed font, or path of a font file; ``None``: the built-in alphabet.
        scale: Unit of a mesh: mm, cm, m or inch; ``None``: metres.
        lay: Pose of a mesh: its most stable one, its most stable one on a flat side, or the one in which it was
            modelled.
        wall: Thickness of the wall to give to an open mesh [m]; ``None``: its holes are closed.
    """

    mass: float | None = None
    friction: float | None = None
    height: float | None = None
    size: float | None = None
    font: str | None = None
    scale: str | None = None
    lay: Lay = "stable"
    wall: float | None = None

    def given(self) -> dict[str, Any]:
        """Returns the options that were given, by name."""
        return {each.name: value for each in fields(self) if (value := getattr(self, each.name)) != each.default}


class _NamedShape(NamedTuple):
    """A parsed spec: the shape, its name, and the text after the colon."""

    name: str
    shape: Shape
    text: str


def parse_object(
    spec: str, options: ShapeOptions = ShapeOptions(), *, folder: Path = Path(), static: bool = False
) -> Pushable:
    """Creates an object from its spec.

    Args:
        spec: A shape's spec (:data:`oimppi_warp.registries.SHAPES`), the name of an object in the folder, or a file.
        options: Options beyond the spec.
        folder: Destination of the scene; objects in its ``objects/`` can be referred to by name.
        static: Whether the object is an obstacle; one from a USD file may then be of any size.

    Raises:
        ConfigError: There is no such object, or it cannot be made with these options.
        SceneError: A mesh or USD file cannot be used as an object.
    """
    named = _find_shape(spec)
    if named is not None and named.shape.example:
        return _make(named.shape, named.shape.parse(spec, named.name, named.text), options)
    name, file = spec.replace("-", "_"), Path(spec).expanduser()
    candidates = (folder / "objects" / f"{name}{ending}" for ending in ENDINGS)
    given = {"mass": options.mass, "friction": options.friction}
    own = next((read_object(place, **given, static=static) for place in candidates if place.is_file()), None)
    # A file left there by an earlier task still means the shape, if the shape's spec is its name alone.
    if named is not None and (own is None or own.doc == _make(named.shape, (), ShapeOptions()).doc):
        return _make(named.shape, (), options)
    if own is None and (meshed := _shape_of_file(spec)) is not None:
        return _make(meshed.shape, (spec,), options)
    stored = own or (read_object(file, **given, static=static) if is_object_file(file) else None)
    if stored is None:
        raise ConfigError(f"{spec}: there is no such object\n  allowed: {objects()}{_suggestion(spec)}")
    return stored


def parse_obstacle(spec: str, options: ShapeOptions = ShapeOptions(), *, name: str, folder: Path = Path()) -> Obstacle:
    """Creates an obstacle from its spec: a shape with a prim of its own type, or an object that does not move.

    Args:
        spec: An object's spec, as for :func:`parse_object`, followed by ``@X,Y`` or ``@X,Y,YAW``.
        options: Options for an object used as an obstacle; mass and friction apply to the pushed object only.
        name: Name of the obstacle's prim.
        folder: Destination of the scene.

    Raises:
        ConfigError: The spec does not describe an obstacle.
        SceneError: A mesh or USD file cannot be used as an object.
    """
    what, at, pose_text = spec.rpartition("@")
    if not at:
        raise ConfigError(
            f"--obstacle {spec}: it has no position\n  allowed: {_PLACED}\n"
            f"  to do:   append a position, e.g. {spec}@0.5,0.05"
        )
    numbers = pose_text.split(",")
    if len(numbers) == 2:
        numbers.append("0")
    pose = checked_pose("--obstacle", ",".join(numbers), given=f"--obstacle {spec}", allowed=_PLACED)
    named = _find_shape(what)
    if named is not None and named.shape.make_obstacle is not None:
        return named.shape.make_obstacle(name, pose, *named.shape.parse(spec, named.name, named.text))
    static_options = replace(options, mass=None, friction=None)
    return StaticObject(name, parse_object(what, static_options, folder=folder, static=True), pose)


def parse_obstacles(
    specs: Iterable[str], options: ShapeOptions = ShapeOptions(), *, folder: Path = Path()
) -> tuple[Obstacle, ...]:
    """Creates obstacles from specs, with descriptive names."""
    found: list[Obstacle] = []
    taken: set[str] = set()
    for spec in specs:
        plain = _prim_name(spec.rpartition("@")[0])
        name = next(n for n in chain([plain], (f"{plain}{i}" for i in count(2))) if n not in taken)
        taken.add(name)
        found.append(parse_obstacle(spec, options, name=name, folder=folder))
    return tuple(found)


def check_used(options: ShapeOptions, specs: Iterable[str]) -> None:
    """Checks that every given option applies to at least one of the objects.

    Raises:
        ConfigError: An option is unused: a font, size or thickness without letters, say, or a unit without a mesh.
    """
    named = [_find_shape(what) or _shape_of_file(what) for what in (spec.rpartition("@")[0] or spec for spec in specs)]
    taken = {option for each in named if each is not None for option in each.shape.options}
    for option, value in options.given().items():
        if option not in taken and option not in COMMON_OPTIONS:
            *others, last = shapes_taking(option)
            what = f"{', '.join(others)} or {last}" if others else last
            raise ConfigError(f"--{option} {value} does not apply to any of the objects\n  allowed: only with {what}")


def checked_pose(option: str, text: str, *, given: str = "", allowed: str = POSE) -> Pose:
    """Parses a planar pose "x,y,yaw"; a yaw so large that it must be in degrees is refused.

    Args:
        option, text, given, allowed: As for :func:`oimppi_warp.runtime.request.parse_pose`.

    Raises:
        ConfigError: The text is not a valid pose.
    """
    x, y, yaw = parse_pose(option, text, given=given, allowed=allowed)
    if abs(yaw) > 2.0 * math.pi + 1e-3:
        raise ConfigError(
            f"{given or f'{option} {text}'}: a yaw of {yaw:g} radians is more than a full turn\n"
            f"  allowed: -6.283 to 6.283 rad; {yaw:g} degrees are {math.radians(yaw):.4g} rad"
        )
    return x, y, yaw


def _find_shape(spec: str) -> _NamedShape | None:
    """Finds the shape that a spec names: with a colon, one that takes an argument; without one, one that takes none."""
    kind, colon, text = spec.partition(":")
    wanted = _plain(kind)
    for name, shape in SHAPES.loadable():
        if _plain(name) == wanted and bool(colon) == bool(shape.example):
            return _NamedShape(name, shape, text)
    return None


def _shape_of_file(spec: str) -> _NamedShape | None:
    """Finds the shape that is made from files with this extension."""
    ending = Path(spec).suffix.lower()
    found = (_NamedShape(name, shape, spec) for name, shape in SHAPES.loadable() if ending in shape.files)
    return next(found, None) if ending else None


def _plain(name: str) -> str:
    """Normalizes a name for comparison: one case, with dashes."""
    return name.strip().lower().replace("_", "-")


def _make(shape: Shape, given: Arguments, options: ShapeOptions) -> Pushable:
    """Makes a shape's object, passing the options that it accepts."""
    taken = {name: value for name, value in options.given().items() if name in (*COMMON_OPTIONS, *shape.options)}
    return shape.make(*given, **taken)


def _prim_name(what: str) -> str:
    """Returns a descriptive prim name for an obstacle."""
    named = _find_shape(what)
    if named is not None and named.shape.example:
        return named.shape.prim(named.name, named.text)
    return prim_name(Path(what.partition(":")[2] or what).stem)


def _suggestion(spec: str) -> str:
    """Returns the nearest known specs as a line of a message; empty if none is near."""
    examples = {_plain(name): f"{name}:{shape.example}" if shape.example else name for name, shape in SHAPES.loadable()}
    near = difflib.get_close_matches(_plain(spec.partition(":")[0]), examples, n=1, cutoff=0.5)
    return f"\n  to do:   did you mean {examples[near[0]]}?" if near else ""
