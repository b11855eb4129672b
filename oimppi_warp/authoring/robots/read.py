"""Reads a robot from a file of any of the formats: URDF, MJCF or USD."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from oimppi_warp.authoring.robots.arm import Arm
from oimppi_warp.authoring.robots.articulation import Articulation, ToolAxis
from oimppi_warp.authoring.robots.chain import Chain
from oimppi_warp.errors import OimppiError, SceneError

_USD = (".usd", ".usda", ".usdc", ".usdz")
_MJCF = ("mujoco", "mujocoinclude")


def read_arm(
    file: Path, *, name: str, doc: str, length: float, radius: float, axis: ToolAxis = "z", flange: str = ""
) -> tuple[Chain, Arm]:
    """Reads a robot's file, and gives the robot a stick.

    USD files are known by their ending; URDF and MJCF by their root element, ``<robot>`` or ``<mujoco>``.

    Args:
        file: The URDF, MJCF or USD file.
        name: Name of the arm's root prim.
        doc: Description, written to the robot's file.
        length, radius: Dimensions of the stick [m].
        axis: Axis of the flange along which the stick points: x, y, z, -x, -y or -z.
        flange: The link that carries the stick; other moving links are then ignored. Empty: the end of the only chain.

    Returns:
        The names of links and joints in the file, and the arm, with a start of all zeros.

    Raises:
        SceneError: The file cannot be read, or has no serial arm with a fixed base.
    """
    try:
        chain, robot = _read(file, flange)
        return chain, robot.arm(chain, name=name, doc=doc, length=length, radius=radius, axis=axis)
    except OimppiError:
        raise
    except Exception as error:  # importers raise many kinds of exceptions about what they did not expect
        raise SceneError(
            f"the robot cannot be read ({type(error).__name__}: {error})",
            file=file,
            allowed="a valid URDF, MJCF or USD file of one serial arm",
            fix="look for the mistake with another program that reads the format, and report it if there is none",
        ) from error


def _read(file: Path, flange: str) -> tuple[Chain, Articulation]:
    """Reads a file of any of the formats."""
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
        return ""  # the reader of the format says what is wrong
    return ""
