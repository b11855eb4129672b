"""Reads a robot from a file of any of the formats: URDF, MJCF or USD."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from oimppi_warp.authoring.robots.articulation import Articulation
from oimppi_warp.authoring.robots.chain import Chain
from oimppi_warp.errors import SceneError

_USD = (".usd", ".usda", ".usdc", ".usdz")
_MJCF = ("mujoco", "mujocoinclude")


def read_robot_file(file: Path, *, flange: str = "") -> tuple[Chain, Articulation]:
    """Reads the chain in a robot's file, with the properties of its links and joints.

    USD files are known by their ending; URDF and MJCF by their root element, ``<robot>`` or ``<mujoco>``.

    Args:
        file: The URDF, MJCF or USD file.
        flange: The link that carries the stick; other moving links are then ignored. Empty: the end of the only chain.

    Raises:
        SceneError: The file cannot be read, or has no serial arm with a fixed base.
    """
    if not file.is_file():
        raise SceneError("there is no such file", file=file, allowed="a URDF, MJCF or USD file")
    if file.suffix.lower() in _USD:
        from oimppi_warp.authoring.robots.from_usd import read_usd

        return read_usd(file, flange=flange)
    if _root_tag(file) in _MJCF:
        from oimppi_warp.authoring.robots.from_mjcf import read_mjcf

        return read_mjcf(file, flange=flange)
    from oimppi_warp.authoring.robots.from_urdf import read_urdf

    return read_urdf(file, flange=flange)


def _root_tag(file: Path) -> str:
    """Returns the name of an XML file's root element; empty if it has none."""
    try:
        for _, element in ET.iterparse(file, events=("start",)):
            return str(element.tag)
    except (ET.ParseError, LookupError, ValueError):
        pass
    return ""
