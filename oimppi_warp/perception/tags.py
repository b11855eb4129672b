"""The tags on an object: which ones, how large, and where; and the file that says so."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.footprint import footprint, height_range, outline, planar_points
from oimppi_warp.perception.opencv import load_opencv
from oimppi_warp.scene import PushedObject

FAMILIES = {
    "apriltag36h11": ("DICT_APRILTAG_36h11", 8),
    "apriltag25h9": ("DICT_APRILTAG_25h9", 7),
    "aruco5x5": ("DICT_5X5_250", 7),
    "aruco6x6": ("DICT_6X6_250", 8),
}
"""Families of tags: the name of each in OpenCV, and the modules along a side, with the black border."""
FAMILY = "apriltag36h11"
"""Default family: the one that is hardest to confuse with anything else."""
SMALLEST = 0.015
"""Smallest tag that is made without being asked for [m]."""
_TOP = 1e-3
"""Depth below its highest point down to which a part of an object still counts as its top [m]."""
_CENTRED = 0.95
"""Share of the largest free circle that the one around the object's origin must have for the tag to be put there."""


@dataclass(frozen=True)
class Tag:
    """A tag that lies flat on an object and faces up.

    Attributes:
        id: Number of the tag in its family.
        size: Side of the black square [m].
        position: Centre of the tag in the object's frame (x, y, z) [m].
        yaw: Rotation of the tag in the object's frame; at 0, its right edge points along the object's x [rad].
    """

    id: int
    size: float
    position: tuple[float, float, float]
    yaw: float = 0.0

    @property
    def corners(self) -> np.ndarray:
        """Returns the corners in the object's frame in OpenCV's order, clockwise from top left, shape [4, 3] [m]."""
        square = self.size / 2.0 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
        flat = planar_points((self.position[0], self.position[1], self.yaw), square)
        return np.column_stack([flat, np.full(4, self.position[2])])


@dataclass(frozen=True)
class TagLayout:
    """The tags on an object.

    Attributes:
        family: Name of the family, one of :data:`FAMILIES`.
        tags: The tags, each with a number of its own.
    """

    family: str
    tags: tuple[Tag, ...]

    def save(self, file: Path) -> None:
        """Writes the tags to a TOML file."""
        lines = ["# The tags on an object, in its frame: metres and radians (docs/perception.md).", ""]
        lines.append(f'family = "{self.family}"')
        for tag in self.tags:
            where = ", ".join(f"{value:.10g}" for value in tag.position)
            lines += ["", "[[tag]]", f"id = {tag.id}", f"size = {tag.size:.10g}  # side of the black square"]
            lines += [f"position = [{where}]", f"yaw = {tag.yaw:.10g}"]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("\n".join(lines) + "\n")


def dictionary(family: str) -> Any:
    """Returns OpenCV's dictionary of a family.

    Raises:
        ConfigError: There is no such family, or OpenCV is not installed.
    """
    if family not in FAMILIES:
        raise ConfigError(f"family {family!r} does not exist\n  allowed: {', '.join(FAMILIES)}")
    aruco = load_opencv().aruco
    return aruco.getPredefinedDictionary(getattr(aruco, FAMILIES[family][0]))


def top_outline(pushed: PushedObject) -> shapely.Geometry:
    """Returns the outline of an object's top, in the object's frame [m]."""
    top = height_range(pushed.colliders)[1]
    return outline(footprint(pushed.colliders, lower=top - _TOP))


def layout_of(pushed: PushedObject, *, family: str = FAMILY, size: float | None = None) -> TagLayout:
    """Returns a layout of one tag, number 0, on an object's top, where there is most room.

    Args:
        pushed: The object.
        family: Name of the family.
        size: Side of the black square [m]; ``None``: whole millimetres, as large as fits with a white border.

    Raises:
        ConfigError: There is no such family, or no room for a tag.
    """
    if family not in FAMILIES:
        raise ConfigError(f"family {family!r} does not exist\n  allowed: {', '.join(FAMILIES)}")
    modules = FAMILIES[family][1]
    parts = [part for part in shapely.get_parts(top_outline(pushed)) if part.area > 0.0]
    circles = [shapely.maximum_inscribed_circle(part, tolerance=2e-4) for part in parts]
    circle = max(circles, key=shapely.length)
    center, radius = np.round(circle.coords[0], 3), circle.length
    middle = shapely.Point(0.0, 0.0)
    around = max(middle.distance(part.boundary) if part.contains(middle) else 0.0 for part in parts)
    if around >= _CENTRED * radius:
        center, radius = np.zeros(2), around
    room = math.sqrt(2.0) * radius * modules / (modules + 2)
    if size is None and room < SMALLEST:
        raise ConfigError(
            f"the top of the object has room for a tag of {1e3 * room:.0f} mm only\n"
            f"  to do:   put a larger tag on a card on top of it, with --size {2 * SMALLEST:g} or more"
        )
    if size is not None and not 0.0 < size < 1.0:
        raise ConfigError(f"the tag cannot be {size:g} m large\n  allowed: above 0, below 1 m")
    size = math.floor(1e3 * room) / 1e3 if size is None else size
    top = height_range(pushed.colliders)[1]
    return TagLayout(family, (Tag(0, size, (float(center[0]), float(center[1]), float(top))),))


def load_layout(file: Path) -> TagLayout:
    """Reads the tags on an object from a TOML file.

    Raises:
        ConfigError: The file does not exist, or is no description of tags.
    """
    try:
        found = tomllib.loads(file.read_text())
    except FileNotFoundError:
        raise ConfigError(f"{file}: there is no such file\n  to do:   oimppi perceive sheet writes one") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{file}: the tags cannot be read: {error}") from None
    try:
        layout = TagLayout(found["family"], tuple(_tag(entry) for entry in found["tag"]))
        if found.keys() != {"family", "tag"}:
            raise ValueError
    except (KeyError, TypeError, ValueError, AttributeError):
        raise ConfigError(
            f"{file}: this is no description of tags\n"
            "  allowed: family, and for each [[tag]] id, size, position (three numbers) and yaw, in metres and radians"
        ) from None
    if layout.family not in FAMILIES:
        raise ConfigError(f"{file}: family {layout.family!r} does not exist\n  allowed: {', '.join(FAMILIES)}")
    ids = [tag.id for tag in layout.tags]
    if not ids or len(set(ids)) != len(ids):
        raise ConfigError(f"{file}: the numbers of the tags are {ids}\n  allowed: at least one tag, no number twice")
    return layout


def _tag(entry: dict[str, Any]) -> Tag:
    """Returns a tag of a file.

    Raises:
        KeyError, TypeError, ValueError: It is none.
    """
    if not entry.keys() <= {"id", "size", "position", "yaw"} or type(entry["id"]) is not int or entry["id"] < 0:
        raise ValueError
    x, y, z = map(float, entry["position"])
    tag = Tag(entry["id"], float(entry["size"]), (x, y, z), float(entry.get("yaw", 0.0)))
    if not all(map(math.isfinite, (tag.size, x, y, z, tag.yaw))) or tag.size <= 0.0:
        raise ValueError
    return tag
