"""Named shapes: the objects and obstacles that specs such as ``box:0.1x0.06x0.05`` or ``letter:S`` denote.

Each shape is an entry of :data:`oimppi_warp.registries.SHAPES`; the command line with its help and messages, and the
table in `docs/authoring.md`, are generated from these entries. The shipped shapes are defined below. Importing this
module is cheap: the code that builds an object is imported when it is first called.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oimppi_warp.authoring.meshes.formats import MESHES
from oimppi_warp.errors import ConfigError

if TYPE_CHECKING:
    from oimppi_warp.authoring.objects.flat_object import FlatObject, Pushable
    from oimppi_warp.authoring.task import Block, Obstacle, Pillar, Pose

Arguments = tuple[float, ...] | tuple[str] | tuple[()]
"""The part of a spec after its colon: numbers, text, or nothing."""

COMMON_OPTIONS = ("mass", "friction")
"""Options that every shape accepts."""


@dataclass(frozen=True)
class Parameter:
    """A number in a spec, such as the radius in ``cylinder:0.033x0.101``.

    Attributes:
        name: Meaning of the parameter, such as ``"radius"``.
        unit: Its unit; empty for a count.
    """

    name: str
    unit: str = "m"


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A named kind of object.

    A spec is either the name alone, or the name, a colon, and numbers or text.

    Attributes:
        about: Description, worded as a table row.
        make: Makes the object: ``make(*given, mass=..., friction=..., ...)``, with the numbers or the text of the spec.
            Those of :data:`COMMON_OPTIONS` and ``options`` that were given are passed by name. Raises ConfigError or
            SceneError if the object cannot be made.
        example: Example of the part after the colon; empty: the name is used alone.
        parameters: Meaning of the numbers; empty: the spec takes text or nothing.
        files: File name extensions, if the text is a file. The path of such a file alone is also a valid spec.
        options: Options accepted in addition to mass and friction, by the names that the command line uses
            (``"height"``, ``"size"``, ``"font"``, ``"scale"``, ``"lay"``, ``"wall"``).
        noun: Name of such shapes in the message for an option that needs them: ``"letters"``.
        make_obstacle: Makes an obstacle with a prim of its own type: ``make_obstacle(name, pose, *given)``; ``None``:
            the object itself becomes a static obstacle.
    """

    about: str
    make: Callable[..., Pushable]
    example: str = ""
    parameters: tuple[Parameter, ...] = ()
    files: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    noun: str = ""
    make_obstacle: Callable[..., Obstacle] | None = None

    def usage(self, name: str) -> str:
        """Returns an example spec with the meaning of its numbers: ``cylinder:0.033x0.101 (radius x height)``."""
        parameters = f" ({' x '.join(parameter.name for parameter in self.parameters)})" if self.parameters else ""
        return (f"{name}:{self.example}" if self.example else name) + parameters

    def parse(self, spec: str, name: str, text: str) -> Arguments:
        """Parses the part of a spec after the colon.

        Args:
            spec: The whole spec, for messages.
            name: The shape's name.
            text: The part after the colon.

        Raises:
            ConfigError: The numbers do not match the shape's parameters.
        """
        if not self.example:
            return ()
        if not self.parameters:
            return (text,)
        try:
            found = tuple(float(part) for part in re.split(r"[x,]", text))
        except ValueError:
            found = ()
        count = len(self.parameters)
        if len(found) != count or not all(math.isfinite(value) and value > 0.0 for value in found):
            lengths = all(parameter.unit == "m" for parameter in self.parameters)
            units = "".join(
                f", {parameter.name} in {parameter.unit}" for parameter in self.parameters if parameter.unit
            )
            raise ConfigError(
                f"{spec}: needs {count} {'lengths' if lengths else 'numbers'} above zero\n"
                f"  allowed: {self.usage(name)}{', in metres' if lengths else units}"
            )
        return found

    def prim(self, name: str, text: str) -> str:
        """Returns a descriptive prim name for an obstacle: Box, LetterO, SoupCan, Bracket."""
        said = name if self.parameters else Path(text).stem if self.files else f"{name} {text}"
        return prim_name(said)


def prim_name(text: str) -> str:
    """Converts text to a prim name."""
    name = "".join(part.title() for part in re.split(r"[^A-Za-z0-9]+", text))
    return name if name[:1].isalpha() else f"Obstacle{name}"


def deferred(target: str) -> Callable[..., Any]:
    """Returns a function that is imported on its first call, from ``"module:function"``."""

    def call(*given: Any, **options: Any) -> Any:
        module, _, function = target.partition(":")
        return getattr(import_module(module), function)(*given, **options)

    return call


# Shipped shapes ----------------------------------------------------------------------------------------------------

_AUTHORING = "oimppi_warp.authoring"


def _block(name: str, pose: Pose, length: float, width: float, height: float) -> Block:
    from oimppi_warp.authoring.task import Block

    return Block(name, pose[:2], (length, width, height), yaw=pose[2])


def _pillar(name: str, pose: Pose, radius: float, height: float) -> Pillar:
    from oimppi_warp.authoring.task import Pillar

    return Pillar(name, pose[:2], radius, height)


def _mesh(file: str, *, lay: str = "stable", **options: Any) -> Pushable:
    return deferred(f"{_AUTHORING}.meshes.solid:import_mesh")(file, lay=lay, **options)


def _from_catalog(name: str) -> Callable[..., FlatObject]:
    """Returns a function that makes an object of the shipped scenes with the given mass and friction."""

    def make(*, mass: float | None = None, friction: float | None = None) -> FlatObject:
        from oimppi_warp.authoring.objects import catalog
        from oimppi_warp.authoring.objects.outlines import checked_friction, checked_mass

        obj: FlatObject = getattr(catalog, name)
        if mass is not None:
            obj = replace(obj, mass=checked_mass(mass, 0.0))
        return obj if friction is None else replace(obj, friction=checked_friction(friction))

    return make


def _shipped(name: str) -> Shape:
    return Shape(about="an object of the shipped scenes", make=_from_catalog(name))


T_BLOCK, LAB_T, SOUP_CAN = _shipped("T_BLOCK"), _shipped("LAB_T"), _shipped("SOUP_CAN")
LETTER_I, LETTER_R, LETTER_O, LETTER_S = (_shipped(f"LETTER_{letter}") for letter in "IROS")

LETTER = Shape(
    about="a capital letter of the built-in alphabet or, with `--font`, a character of an installed font",
    make=deferred(f"{_AUTHORING}.letters.letters:letter"),
    example="S",
    options=("height", "size", "font"),
    noun="letters",
)
TEXT = Shape(
    about="a word as one rigid body: letters joined by a bar below them",
    make=deferred(f"{_AUTHORING}.letters.letters:word"),
    example="WARP",
    options=("height", "size", "font"),
    noun="words",
)
BOX = Shape(
    about="a box",
    make=deferred(f"{_AUTHORING}.objects.outlines:box"),
    example="0.1x0.06x0.05",
    parameters=(Parameter("length"), Parameter("width"), Parameter("height")),
    make_obstacle=_block,
)
CYLINDER = Shape(
    about="an upright cylinder",
    make=deferred(f"{_AUTHORING}.objects.outlines:cylinder"),
    example="0.033x0.101",
    parameters=(Parameter("radius"), Parameter("height")),
    make_obstacle=_pillar,
)
PRISM = Shape(
    about="an upright prism over a regular polygon, whose radius is that of its corners",
    make=deferred(f"{_AUTHORING}.objects.outlines:regular_prism"),
    example="6x0.05x0.04",
    parameters=(Parameter("sides", unit=""), Parameter("radius"), Parameter("height")),
)
MESH = Shape(
    about="a mesh file, converted to an object on the fly ([below](#a-part-of-your-own))",
    make=_mesh,
    example="part.stl",
    files=MESHES,
    options=("scale", "lay", "wall"),
    noun="a mesh",
)
MJCF = Shape(
    about="the rigid body in an MJCF file, with its defaults, includes and meshes",
    make=deferred(f"{_AUTHORING}.objects.mjcf:import_mjcf"),
    example="mug.xml",
    files=(".xml", ".mjcf"),
    options=("lay",),
    noun="an MJCF file",
)


# Descriptions ------------------------------------------------------------------------------------------------------


def usages() -> Iterator[str]:
    """Yields an example spec for each shape, with the meaning of its numbers."""
    from oimppi_warp.registries import SHAPES

    return (shape.usage(name) for name, shape in SHAPES.loadable())


def objects() -> str:
    """Lists the shapes available as objects, for help and messages."""
    return f"{', '.join(usages())}, or the USD file of an object"


def shapes_taking(option: str, by: Callable[[str, Shape], str] = lambda name, shape: shape.noun or name) -> list[str]:
    """Lists the shapes that accept an option, by their display names."""
    from oimppi_warp.registries import SHAPES

    return list(dict.fromkeys(by(name, shape) for name, shape in SHAPES.loadable() if option in shape.options))


def table() -> str:
    """Returns the shapes as rows of a Markdown table: specs and descriptions."""
    from oimppi_warp.registries import SHAPES

    rows: dict[str, list[str]] = {}
    for name, shape in SHAPES.loadable():
        parameters = f" ({', '.join(parameter.name for parameter in shape.parameters)})" if shape.parameters else ""
        rows.setdefault(shape.about + parameters, []).append(
            f"`{name}:{shape.example}`" if shape.example else f"`{name}`"
        )
    return "".join(f"| {', '.join(found)} | {about} |\n" for about, found in rows.items())
