"""Objects and obstacles from words, as the command line takes them: ``letter:S``, ``box:0.1x0.06x0.05@0.5,0.1``."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path

from oimppi_warp.authoring.objects import catalog, letters, shapes
from oimppi_warp.authoring.objects.alphabet import CAP
from oimppi_warp.authoring.objects.meshes import FORMATS
from oimppi_warp.authoring.objects.pose import Lay
from oimppi_warp.authoring.objects.solid import import_mesh
from oimppi_warp.authoring.objects.stored import ENDINGS, is_object_file, read_object
from oimppi_warp.authoring.objects.thing import Pushable, Thing
from oimppi_warp.authoring.task import Block, Obstacle, Pillar, Pose, Standing
from oimppi_warp.errors import ConfigError
from oimppi_warp.task import parse_pose

OBJECTS = (
    "t-block, lab-t, soup-can, letter:S, text:WARP, box:0.1x0.06x0.05, cylinder:0.033x0.101 (radius x height), "
    "mesh:part.stl, or a USD file of an object"
)
"""What an object can be, for help and errors."""

OBSTACLES = "box:0.1,0.1,0.1@0.5,0.05[,YAW], cylinder:0.04,0.15@0.5,0.05 (radius, height), or OBJECT@X,Y[,YAW]"
"""What an obstacle can be, for help and errors."""


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


def parse_object(word: str, manner: Manner = Manner(), *, folder: Path = Path()) -> Pushable:
    """An object from a word.

    Args:
        word: As in :data:`OBJECTS`.
        manner: How it is made, beyond the word.
        folder: Where the scene goes: the objects in ``objects/`` there are known by their names.

    Raises:
        ConfigError: There is no such object, or it cannot be made so.
        SceneError: A mesh or a USD file cannot be an object.
    """
    kind, colon, rest = word.partition(":")
    kind = kind.strip().lower()
    friction = shapes.FRICTION if manner.friction is None else manner.friction
    weight = {"mass": manner.mass, "friction": friction}
    thickness = letters.HEIGHT if manner.height is None else manner.height
    flat = {**weight, "height": thickness, "font": manner.font}
    if kind == "letter" and colon:
        return letters.letter(rest, size=CAP if manner.size is None else manner.size, **flat)
    if kind == "text" and colon:
        return letters.word(rest, size=manner.size, **flat)
    if kind == "box" and colon:
        return shapes.box(*_lengths(word, rest, 3), **weight)
    if kind == "cylinder" and colon:
        return shapes.cylinder(*_lengths(word, rest, 2), **weight)
    if kind == "mesh" and colon:
        return import_mesh(rest, scale=manner.scale, lying=manner.lay, **weight)
    return _known(word, manner, folder)


def parse_obstacle(word: str, manner: Manner = Manner(), *, name: str, folder: Path = Path()) -> Obstacle:
    """An obstacle from a word: a box, a cylinder, or an object that stands fast.

    Args:
        word: As in :data:`OBSTACLES`.
        manner: How an object that stands fast is made; mass and friction are the pushed object's alone.
        name: Of its prim.
        folder: Where the scene goes.

    Raises:
        ConfigError: It is none.
        SceneError: A mesh or a USD file cannot be an object.
    """
    what, at, place = word.rpartition("@")
    if not at:
        raise ConfigError(f"--obstacle {word}: no place\n  allowed: {OBSTACLES}")
    numbers = place.split(",")
    if len(numbers) == 2:
        numbers.append("0")
    x, y, yaw = checked_pose(f"--obstacle {what}@", ",".join(numbers))
    kind, _, rest = what.partition(":")
    if kind == "box":
        length, width, height = _lengths(word, rest, 3)
        return Block(name, (x, y), (length, width, height), yaw=yaw)
    if kind == "cylinder":
        radius, height = _lengths(word, rest, 2)
        return Pillar(name, (x, y), radius, height)
    fast = replace(manner, mass=None, friction=None)
    return Standing(name, parse_object(what, fast, folder=folder), (x, y, yaw))


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


def _prim_name(word: str) -> str:
    """A prim's name that says what it is: Box, LetterO, TextHi, SoupCan, Bracket."""
    kind, colon, rest = word.partition(":")
    if colon and kind.lower() in ("box", "cylinder"):
        return kind.title()
    said = f"{kind} {rest}" if colon and kind.lower() in ("letter", "text") else Path(rest or kind).stem
    name = "".join(part.title() for part in re.split(r"[^A-Za-z0-9]+", said))
    return name if name[:1].isalpha() else f"Obstacle{name}"


def check_used(manner: Manner, words: Iterable[str]) -> None:
    """Refuse what none of the objects takes.

    Raises:
        ConfigError: A font, a size or a thickness without letters, or a unit or a way to lie without a mesh.
    """
    names = [word.rpartition("@")[0] or word for word in words]
    kinds = {name.partition(":")[0].strip().lower() for name in names if ":" in name}
    meshes = "mesh" in kinds or any(Path(name).suffix.lower() in FORMATS for name in names)
    lettered = {"--height": manner.height, "--size": manner.size, "--font": manner.font}
    of_meshes = {"--scale": manner.scale, "--lay": None if manner.lay == "stable" else manner.lay}
    for given, there, what in (
        (lettered, kinds & {"letter", "text"}, "letters and words"),
        (of_meshes, meshes, "a mesh"),
    ):
        for option, value in given.items():
            if value is not None and not there:
                raise ConfigError(f"{option} {value}: there is nothing that it is for\n  allowed: with {what} only")


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


def _lengths(word: str, text: str, count: int) -> tuple[float, ...]:
    """Numbers with x or commas between them."""
    try:
        numbers = tuple(float(part) for part in re.split(r"[x,]", text))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(math.isfinite(n) and n > 0.0 for n in numbers):
        example = (
            "box:0.1x0.06x0.05 (length x width x height)" if count == 3 else "cylinder:0.033x0.101 (radius x height)"
        )
        raise ConfigError(f"{word}: {count} lengths above zero are needed\n  allowed: {example}, in metres")
    return numbers


def _known(word: str, manner: Manner, folder: Path) -> Pushable:
    """One of the folder's objects, a shipped one, or a file; what tasks left there of a shipped one is still that."""
    name = word.replace("-", "_")
    shipped = next((thing for thing in catalog.THINGS if thing.name == name), None)
    file = Path(word).expanduser()
    places = (folder / "objects" / f"{name}{ending}" for ending in ENDINGS)
    own = next((read_object(place) for place in places if place.is_file()), None)
    if shipped is not None and (own is None or own.doc == shipped.doc):
        return _weighed(shipped, manner)
    if own is None and file.suffix.lower() in FORMATS:
        return parse_object(f"mesh:{word}", manner)
    stored = own or (read_object(file) if is_object_file(file) else None)
    if stored is not None:
        if manner.mass is not None or manner.friction is not None:
            raise ConfigError(
                f"--object {word}: its mass and friction stand in its file\n"
                f"  allowed: physics:mass and physics:dynamicFriction in {stored.file}"
            )
        return stored
    near = difflib.get_close_matches(
        name, [*(thing.name for thing in catalog.THINGS), "letter", "text", "box", "cylinder", "mesh"], n=1, cutoff=0.5
    )
    guess = f"\n  did you mean {near[0].replace('_', '-')}?" if near else ""
    raise ConfigError(f"{word}: there is no such object\n  allowed: {OBJECTS}{guess}")


def _weighed(thing: Thing, manner: Manner) -> Thing:
    """A shipped object with the mass and the friction asked for."""
    if manner.mass is not None:
        thing = replace(thing, mass=shapes.checked_mass(manner.mass, 0.0))
    if manner.friction is not None:
        thing = replace(thing, friction=shapes.checked_friction(manner.friction))
    return thing
