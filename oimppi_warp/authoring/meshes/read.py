"""Reads a mesh file as one closed surface in metres: repairs it, or refuses it and gives the reason."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from oimppi_warp.authoring.meshes.formats import MESHES
from oimppi_warp.authoring.meshes.holes import fill_holes
from oimppi_warp.authoring.meshes.parts import cleaned, merged
from oimppi_warp.authoring.meshes.sides import one_side, thickened
from oimppi_warp.authoring.objects.outlines import SIZES
from oimppi_warp.errors import ConfigError, SceneError
from oimppi_warp.geometry.orient import orient

UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0, "inch": 0.0254}
"""Units that a mesh may be in, in metres."""

PARTS = 20
"""Maximum number of separate parts of one object."""

FILLED = 0.15
"""Largest share of the surface that may be missing from a mesh."""

SHELL = 0.03
"""Share of the surface from which on missing parts may be the opening of a shell."""

WALLS = (0.0005, 0.05)
"""Range of the thickness that an open surface can be given [m]."""

FACES = 200_000
"""Maximum number of triangles of a mesh."""

_MAKE_SOLID = (
    "make it a closed solid in your modelling program: in Blender, enable 3D Print Toolbox, then Clean Up > Make "
    "Manifold"
)
_EXPORT_AGAIN = "export it again from your modelling program, as a surface; or download it again"
_OR_WALL = "; or, if it is a shell, give it a wall, in metres: --wall 0.002"


_FLAT = 1e-6  # volume of a part over its area to the power of 1.5; a ball has 0.094

_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes of a binary STL: its header, which ends with a number, and a triangle


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface read from a mesh file.

    Attributes:
        mesh: The triangle mesh [m].
        parts: Number of separate parts.
        notes: Changes made to the mesh, one line each.
    """

    mesh: trimesh.Trimesh
    parts: int
    notes: tuple[str, ...]


def read_surface(file: str | Path, scale: str | None = None, wall: float | None = None) -> Surface:
    """Reads a mesh, scales it to metres, and closes it.

    Args:
        file: The mesh; if it holds several meshes, they are merged.
        scale: Its unit, one of :data:`UNITS`; ``None``: metres.
        wall: Thickness of the wall to give to an open surface [m]; ``None``: its holes are closed.

    Raises:
        ConfigError: The unit is unknown, or the thickness is out of range.
        SceneError: The file is not a mesh, has no volume, is of a size that the arm cannot push, has too many parts, or
            is open and cannot be closed, or has only one side; or a wall is asked for, and the surface is closed.
    """
    file = Path(file).expanduser()
    if scale is not None and scale not in UNITS:
        raise ConfigError(f"--scale {scale}: unknown unit\n  allowed: {', '.join(UNITS)}")
    if wall is not None and not WALLS[0] <= wall <= WALLS[1]:
        raise ConfigError(f"--wall {wall:g}: out of range\n  allowed: {WALLS[0]:g} to {WALLS[1]:g} m")
    mesh = _read(file)
    _check_size(file, mesh, scale)
    mesh.apply_scale(UNITS[scale or "m"])
    mesh = merged(mesh)
    if not len(mesh.faces):
        raise _flat_error(file, "all of its faces are degenerate")
    single = None if mesh.is_watertight else one_side(mesh)
    mesh = cleaned(mesh if single is None else single)
    notes = [] if single is None else ["double-sided: each face was listed for both sides, and now counts once"]
    if wall is None:
        _check_volume(file, mesh)
    parts = mesh.body_count
    if parts > PARTS:
        raise SceneError(
            f"the mesh consists of {parts} separate parts",
            file=file,
            allowed=f"one solid, or up to {PARTS} parts that move as one",
            fix="in your modelling program, join them and remove screws, text and other small features",
        )
    if wall is not None:
        mesh = _with_wall(file, mesh, wall)
        notes.append(f"given a wall of {1000 * wall:g} mm, on its inner side")
    elif single is not None and not mesh.is_watertight:
        holes = _count_text(_hole_count(mesh), "opening")
        raise _shell_error(file, f"the mesh is a shell without thickness, with {holes}: its faces have both sides")
    notes += _close(file, mesh)
    if mesh.volume < 0.0:
        mesh.invert()
        notes.append("inverted, as it was inside out")
    if mesh.volume < 1e-3 * mesh.convex_hull.volume:
        raise _flat_error(file, f"the mesh encloses {1e6 * mesh.volume:.3g} cm3")
    return Surface(mesh, parts, tuple(notes))


def _read(file: Path) -> trimesh.Trimesh:
    """Returns the triangles of a file, in the file's own units."""
    formats = ", ".join(MESHES)
    if not file.is_file():
        raise SceneError("there is no such file", file=file, allowed=f"a mesh: {formats}")
    if file.suffix.lower() not in MESHES:
        fix = "export the part as STL from your modelling program"
        raise SceneError(
            f"the extension ({file.suffix or 'none'}) is not that of a mesh", file=file, allowed=formats, fix=fix
        )
    try:
        with _silent():
            mesh = trimesh.load_scene(str(file)).to_mesh()
    except Exception as error:  # readers of a dozen formats raise many kinds of exceptions
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        what = _damage(file) or f"the mesh cannot be read ({reason})"
        raise SceneError(what, file=file, allowed=formats, fix=_EXPORT_AGAIN) from None
    if file.suffix.lower() in (".glb", ".gltf"):  # y is up in glTF
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    if not len(mesh.faces):
        what = _damage(file) or "the file contains no triangles"
        raise SceneError(what, file=file, allowed="triangles that enclose a volume", fix=_EXPORT_AGAIN)
    if mesh.vertices.shape[1:] != (3,) or not np.isfinite(mesh.vertices).all():
        three = mesh.vertices.shape[1:] == (3,)
        what = f"the mesh has vertices {'that are not finite' if three else 'without three coordinates'}"
        raise SceneError(what, file=file, allowed="triangles that enclose a volume", fix=_EXPORT_AGAIN)
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        what = "the mesh has faces whose corners do not exist"
        raise SceneError(what, file=file, allowed=f"corners from 0 to {len(mesh.vertices) - 1}", fix="export it again")
    if len(mesh.faces) > FACES:
        raise SceneError(
            f"the mesh has {len(mesh.faces)} triangles",
            file=file,
            allowed=f"up to {FACES} triangles",
            fix="export it at a lower resolution, or decimate it: an accuracy of 0.5 mm is sufficient",
        )
    return mesh


def _damage(file: Path) -> str:
    """Returns what is wrong with a file as a whole; empty if it seems to be a mesh."""
    content = file.read_bytes()
    if not content.strip():
        return "the file is empty"
    if content.lstrip().lower().startswith((b"<html", b"<!doctype html")):
        return "the file is a web page, not a mesh"
    if file.suffix.lower() == ".stl" and len(content) >= _STL_HEADER:
        whole = _STL_HEADER + _STL_TRIANGLE * int.from_bytes(content[_STL_HEADER - 4 : _STL_HEADER], "little")
        if len(content) < whole and b"facet" not in content:
            return f"the file is cut off: it has {len(content)} of {whole} bytes"
    return ""


@contextmanager
def _silent() -> Iterator[None]:
    """Returns a context in which trimesh logs nothing: it logs the tracebacks of what it tries."""
    log = logging.getLogger("trimesh")
    before, log.disabled = log.disabled, True
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        log.disabled = before


def _check_size(file: Path, mesh: trimesh.Trimesh, scale: str | None) -> None:
    """Raises SceneError for a size that the arm cannot push, suggesting a unit that would fit."""
    low, high = SIZES
    longest = float(mesh.extents.max())
    in_meters = longest * UNITS[scale or "m"]
    if low <= in_meters <= high:
        return
    fitting = [unit for unit, meters in UNITS.items() if low <= longest * meters <= high]
    size = " x ".join(f"{side * UNITS[scale or 'm']:.3g}" for side in mesh.extents)
    taken = f"with --scale {scale}" if scale else "read in metres"
    would = ", ".join(f"--scale {unit} makes it {longest * UNITS[unit]:.3g} m long" for unit in fitting)
    raise SceneError(
        f"the mesh is too {'large' if in_meters > high else 'small'} for the arm: {size} m, {taken}",
        file=file,
        allowed=f"{low:g} to {high:g} m for the longest side",
        fix=f"the mesh is probably in another unit: {would}" if would else "scale the part; no unit makes it fit",
    )


def _check_volume(file: Path, mesh: trimesh.Trimesh) -> None:
    """Raises SceneError for a flat sheet, which has no volume even after its rim is closed."""
    if len(mesh.faces) < 4 or mesh.bounding_box_oriented.primitive.extents.min() < 1e-4:
        raise _flat_error(file, "the mesh is flat")


def _flat_error(file: Path, what: str) -> SceneError:
    fix = "give the part a thickness in your modelling program, or with --wall, in metres: --wall 0.01"
    return SceneError(what, file=file, allowed="a solid: a surface that encloses a volume", fix=fix)


def _shell_error(file: Path, what: str) -> SceneError:
    fix = "give it a wall, in metres: --wall 0.002; or close it in your modelling program"
    return SceneError(what, file=file, allowed="a solid: a surface that encloses a volume", fix=fix)


def _with_wall(file: Path, mesh: trimesh.Trimesh, wall: float) -> trimesh.Trimesh:
    """Returns an open surface as a closed solid with a wall of this thickness [m]."""
    if mesh.is_watertight:
        raise SceneError(
            f"--wall {wall:g} does not apply: the surface is closed, so the mesh is a solid",
            file=file,
            allowed="--wall with an open surface only",
            fix="leave out --wall",
        )
    orient(mesh)
    rim = mesh.edges[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    if len(rim):  # the inner side is the one that closing the rim would enclose
        a, b, c = np.moveaxis(mesh.triangles - mesh.vertices[rim.ravel()].mean(axis=0), 1, 0)
        if np.einsum("fi,fi->", a, np.cross(b, c)) < 0.0:
            mesh.invert()
    return thickened(mesh, wall)


def _close(file: Path, mesh: trimesh.Trimesh) -> list[str]:
    """Closes the surface and returns a list of the changes made."""
    notes: list[str] = []
    if not mesh.is_winding_consistent:
        orient(mesh)
        notes.append("inconsistently oriented faces were flipped")
    if np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1].max() > 2:
        raise SceneError(
            "the mesh is not manifold: some edges are shared by more than two faces",
            file=file,
            allowed="a mesh whose edges each belong to at most two faces",
            fix=_MAKE_SOLID,
        )
    if not mesh.is_winding_consistent:
        raise SceneError(
            "the faces cannot be oriented consistently: the surface has one side only",
            file=file,
            allowed="a surface with an inside and an outside",
            fix=_MAKE_SOLID,
        )
    if not mesh.is_watertight:
        area, holes = float(mesh.area), _hole_count(mesh)
        fill_holes(mesh)
        _check_parts(file, mesh)
        share = 1.0 - area / float(mesh.area)
        missing = (
            f"{_count_text(holes, 'hole')} of {1e4 * (mesh.area - area):.3g} cm2, {100 * share:.2g} % of the surface"
        )
        if not mesh.is_watertight:
            raise _open_error(file, f"the surface is open ({_count_text(holes, 'hole')}) and could not be closed")
        if share > FILLED:
            raise _open_error(file, f"too much of the surface is missing: {missing}")
        hollow = "; if it is hollow there, a shell, use --wall 0.002" if share > SHELL else ""
        notes.append(f"closed {missing}{hollow}")
    trimesh.repair.fix_inversion(mesh, multibody=mesh.body_count > 1)
    return notes


def _check_parts(file: Path, mesh: trimesh.Trimesh) -> None:
    """Raises SceneError for a part that is flat: a face that sticks out of a solid, or lies beside it."""
    part = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    a, b, c = np.moveaxis(mesh.triangles - mesh.centroid, 1, 0)
    volumes = np.abs(np.bincount(part, weights=np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0))
    areas = np.bincount(part, weights=mesh.area_faces)
    if len(volumes) > 1 and (volumes < _FLAT * areas**1.5).any():
        raise SceneError(
            "a part of the mesh is flat: a face without thickness beside or at a solid",
            file=file,
            allowed="parts that each enclose a volume",
            fix=_MAKE_SOLID,
        )


def _open_error(file: Path, what: str) -> SceneError:
    return SceneError(
        what,
        file=file,
        allowed=f"a closed surface, or one with up to {100 * FILLED:.0f} % of its area missing",
        fix=_MAKE_SOLID + _OR_WALL,
    )


def _hole_count(mesh: trimesh.Trimesh) -> int:
    """Returns the number of holes: connected rims of edges that belong to one face only."""
    lone = mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)]
    return len(trimesh.graph.connected_components(lone, min_len=3))


def _count_text(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
