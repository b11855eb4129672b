"""Objects and obstacles from words, as the command line takes them: ``letter:S``, ``box:0.1x0.06x0.05@0.5,0.1``."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from oimppi_warp.authoring.meshes.pose import Lay
from oimppi_warp.authoring.named_shapes import WEIGHT, Given, Shape, objects, obstacles, prim_name, takers
from oimppi_warp.authoring.objects.flat_object import Pushable
from oimppi_warp.authoring.objects.stored import ENDINGS, is_object_file, read_object
from oimppi_warp.authoring.task import Obstacle, Pose, Standing
from oimppi_warp.errors import ConfigError
from oimppi_warp.registries import SHAPES
from oimppi_warp.runtime.request import parse_pose


@dataclass(frozen=True)
class Manner:
    """How an object is made, as far as its word does not say.

    Attributes:
        mass: [kg]; ``None``: a shipped object's own, else what wood of its volume weighs.
        friction: Coulomb coefficient with the table; ``None``: a shipped object's own, else 0.4.
        height: Thickness of letters and words [m]; ``None``: 0.05.
        size: Height of a letter as it lies [m]; ``None``: 0.103, or what a long word has room for.
        font: An installed font, or the file of one; ``None``: our own alphabet.
        scale: Unit of a mesh: mm, cm, m or inch; ``None``: metres.
        lay: How a mesh lies: in its most stable pose, or as it was modelled.
    """

    mass: float | None = None
    friction: float | None = None
    height: float | None = None
    size: float | None = None
    font: str | None = None
    scale: str | None = None
    lay: Lay = "stable"

    def given(self) -> dict[str, Any]:
        """Those that were given, by their names."""
        return {each.name: value for each in fields(self) if (value := getattr(self, each.name)) != each.default}


class _Named(NamedTuple):
    """A word taken apart: the shape, its name, and the text after the colon."""

    name: str
    shape: Shape
    text: str


def parse_object(word: str, manner: Manner = Manner(), *, folder: Path = Path()) -> Pushable:
    """An object from a word.

    Args:
        word: A shape's (:data:`oimppi_warp.registries.SHAPES`), the name of an object in the folder, or a file.
        manner: How it is made, beyond the word.
        folder: Where the scene goes: the objects in ``objects/`` there are known by their names.

    Raises:
        ConfigError: There is no such object, or it cannot be made so.
        SceneError: A mesh or a USD file cannot be an object.
    """
    named = _named(word)
    if named is not None and named.shape.example:
        return _make(named.shape, named.shape.read(word, named.name, named.text), manner)
    name, file = word.replace("-", "_"), Path(word).expanduser()
    places = (folder / "objects" / f"{name}{ending}" for ending in ENDINGS)
    own = next((read_object(place, mass=manner.mass) for place in places if place.is_file()), None)
    # What tasks left there of a shape that is known by its name alone is still that.
    if named is not None and (own is None or own.doc == _make(named.shape, (), Manner()).doc):
        return _make(named.shape, (), manner)
    if own is None and (meshed := _of_file(word)) is not None:
        return _make(meshed.shape, (word,), manner)
    stored = own or (read_object(file, mass=manner.mass) if is_object_file(file) else None)
    if stored is None:
        raise ConfigError(f"{word}: there is no such object\n  allowed: {objects()}{_guess(word)}")
    if manner.friction is not None or manner.mass != stored.mass:
        raise ConfigError(
            f"--object {word}: its mass and friction stand in its file\n"
            f"  allowed: physics:mass and physics:dynamicFriction in {stored.file}"
        )
    return stored


def parse_obstacle(word: str, manner: Manner = Manner(), *, name: str, folder: Path = Path()) -> Obstacle:
    """An obstacle from a word: a shape that has a prim of its own, or an object that stands fast.

    Args:
        word: An object's, as :func:`parse_object` takes it, with ``@X,Y`` or ``@X,Y,YAW`` behind it.
        manner: How an object that stands fast is made; mass and friction are the pushed object's alone.
        name: Of its prim.
        folder: Where the scene goes.

    Raises:
        ConfigError: It is none.
        SceneError: A mesh or a USD file cannot be an object.
    """
    what, at, place = word.rpartition("@")
    if not at:
        raise ConfigError(f"--obstacle {word}: no place\n  allowed: {obstacles()}")
    numbers = place.split(",")
    if len(numbers) == 2:
        numbers.append("0")
    pose = checked_pose(f"--obstacle {what}@", ",".join(numbers))
    named = _named(what)
    if named is not None and named.shape.stand is not None:
        return named.shape.stand(name, pose, *named.shape.read(word, named.name, named.text))
    fast = replace(manner, mass=None, friction=None)
    return Standing(name, parse_object(what, fast, folder=folder), pose)


def parse_obstacles(words: Iterable[str], manner: Manner = Manner(), *, folder: Path = Path()) -> tuple[Obstacle, ...]:
    """Obstacles from words, with names that say what they are."""
    found: list[Obstacle] = []
    taken: set[str] = set()
    for word in words:
        plain = _prim_name(word.rpartition("@")[0])
        name = next(n for n in chain([plain], (f"{plain}{i}" for i in count(2))) if n not in taken)
        taken.add(name)
        found.append(parse_obstacle(word, manner, name=name, folder=folder))
    return tuple(found)


def check_used(manner: Manner, words: Iterable[str]) -> None:
    """Refuse what none of the objects takes.

    Raises:
        ConfigError: A font, a size or a thickness without letters, say, or a unit without a mesh.
    """
    named = [_named(what) or _of_file(what) for what in (word.rpartition("@")[0] or word for word in words)]
    taken = {option for each in named if each is not None for option in each.shape.options}
    for option, value in manner.given().items():
        if option not in taken and option not in WEIGHT:
            what = " and ".join(takers(option))
            raise ConfigError(f"--{option} {value}: there is nothing that it is for\n  allowed: with {what} only")


def checked_pose(option: str, text: str) -> Pose:
    """A planar pose from "x,y,yaw"; a yaw that must be degrees is refused.

    Raises:
        ConfigError: It is none.
    """
    x, y, yaw = parse_pose(option, text)
    if abs(yaw) > 2.0 * math.pi + 1e-3:
        raise ConfigError(
            f"{option} {text}: a yaw of {yaw:g} radians is more than a turn\n"
            f"  allowed: -6.283 to 6.283 rad; {yaw:g} degrees are {math.radians(yaw):.4g}"
        )
    return x, y, yaw


def _named(word: str) -> _Named | None:
    """The shape that a word names; with a colon one that has something behind it, without one a name alone."""
    kind, colon, text = word.partition(":")
    wanted = _plain(kind)
    for name, shape in SHAPES.loadable():
        if _plain(name) == wanted and bool(colon) == bool(shape.example):
            return _Named(name, shape, text)
    return None


def _of_file(word: str) -> _Named | None:
    """The shape that is made from a file with this ending."""
    ending = Path(word).suffix.lower()
    found = (_Named(name, shape, word) for name, shape in SHAPES.loadable() if ending in shape.files)
    return next(found, None) if ending else None


def _plain(name: str) -> str:
    """A name as it is compared: letters of one size, with dashes."""
    return name.strip().lower().replace("_", "-")


def _make(shape: Shape, given: Given, manner: Manner) -> Pushable:
    """A shape's object, with those of the options that it takes."""
    options = {name: value for name, value in manner.given().items() if name in (*WEIGHT, *shape.options)}
    return shape.make(*given, **options)


def _prim_name(what: str) -> str:
    """A prim's name that says what stands there."""
    named = _named(what)
    if named is not None and named.shape.example:
        return named.shape.prim(named.name, named.text)
    return prim_name(Path(what.partition(":")[2] or what).stem)


def _guess(word: str) -> str:
    """Returns the nearest known words as a line of a message; empty if none is near."""
    examples = {_plain(name): f"{name}:{shape.example}" if shape.example else name for name, shape in SHAPES.loadable()}
    near = difflib.get_close_matches(_plain(word.partition(":")[0]), examples, n=1, cutoff=0.5)
    return f"\n  did you mean {examples[near[0]]}?" if near else ""
