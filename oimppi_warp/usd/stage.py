"""An open scene file: the roles of its prims, their attributes, and their transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from pxr import Ar, Gf, Plug, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdUtils

from oimppi_warp.errors import Problem, SceneError
from oimppi_warp.usd.conversion.property_types import invalid_properties, usd_reason
from oimppi_warp.usd.conversion.units import to_si, to_z_up
from oimppi_warp.usd.conversion.upright import align_upright
from oimppi_warp.usd.frames import format_numbers, is_rigid, scales, shortest_decimal
from oimppi_warp.usd.meshes import simplify_meshes

P = ParamSpec("P")
Read = TypeVar("Read")
Fallback = TypeVar("Fallback")

MAX_LENGTH = 1e3
"""Upper bound for every length in a scene [m]."""

SCENES = Path(__file__).resolve().parent.parent / "scenes"
SCHEMA = SCENES / "schema"

# A codeless schema must be registered before USD builds its registry, which happens when the first stage is opened.
Plug.Registry().RegisterPlugins(str(SCHEMA))


class SceneStage:
    """A composed USD stage in metres, kilograms and z up, with access to its task, robot, object and table.

    A file in other units, with another up axis, or with meshes that a simple shape replaces, is converted as it is
    opened (``units.py``, ``upright.py``, ``meshes.py``). Every reader of a scene's file reads this stage, so that all
    of them read the same numbers.

    Args:
        file: The USD file.
        mistakes: List that collects mistakes; without it, the first one is raised.

    Attributes:
        file: The USD file.
        stage: The stage; its edit target is the session layer, so edits leave the file unchanged.
        layers: The files that it is composed of.

    Raises:
        SceneError: The file does not exist, is not USD, refers to something that is missing, or does not give its
            units.
    """

    def __init__(self, file: Path, mistakes: list[SceneError] | None = None) -> None:
        self.file = file
        self._mistakes = mistakes
        if not file.is_file():
            raise self.error("there is no such file", allowed="a USD file", fix="correct the path")
        silenced = UsdUtils.CoalescingDiagnosticDelegate()  # keeps USD's own warnings out of the terminal
        try:
            self.stage = self._open()
            self.layers = tuple({file_of(layer): None for layer in self.stage.GetUsedLayers() if layer.realPath})
            self._check_units()
            self._convert()
        except Tf.ErrorException as error:
            raise self._unreadable(error) from None
        finally:
            del silenced

    def _open(self) -> Usd.Stage:
        """Opens the stage as composed by USD; raises SceneError if any of it cannot be read."""
        try:
            stage = Usd.Stage.Open(str(self.file))
        except Tf.ErrorException as error:
            formats = ".usda, .usd, .usdc, .usdz"
            raise self.error(
                f"the file cannot be read as USD ({usd_reason(error)})",
                allowed=formats,
                fix="export it again, or correct it at the location that USD reports",
            ) from None
        allowed = "an existing file and an existing prim in it"
        fix = "correct the reference; its path is relative to the file that contains it"
        broken = stage.GetCompositionErrors()
        self._stop_at([self.error(str(each), allowed=allowed, fix=fix) for each in broken])
        if not stage.GetPseudoRoot().GetAllChildren():
            what = "the file has no prims: it is empty, or ends too early"
            raise self.error(what, allowed="a scene", fix="export it again, or begin with `oimppi scene new`")
        invalid = invalid_properties(stage)
        self._stop_at([self.error(each.what, each.prim, allowed=each.allowed, fix=each.fix) for each in invalid])
        return stage

    def _convert(self) -> None:
        """Converts units and the up axis, and replaces meshes by simple shapes."""
        self.stage.SetEditTarget(self.stage.GetSessionLayer())
        to_si(self.stage)
        to_z_up(self.stage)
        align_upright(self.stage)
        simplify_meshes(self.stage)

    def _stop_at(self, mistakes: list[SceneError]) -> None:
        """Notes mistakes and, if there are any, stops reading, as unreadable content would cause spurious mistakes."""
        for mistake in mistakes[:-1]:
            self.collect(mistake)
        if mistakes:
            raise mistakes[-1]

    def collect(self, mistake: SceneError) -> None:
        """Notes a mistake, or raises it if the stage was opened without a list of mistakes."""
        if self._mistakes is None:
            raise mistake
        if str(mistake) not in map(str, self._mistakes):
            # A traceback's frames would keep the stage alive, and USD from rereading a changed file.
            self._mistakes.append(mistake.with_traceback(None))

    def attempt(
        self, fallback: Fallback, read: Callable[P, Read], *args: P.args, **kwargs: P.kwargs
    ) -> Read | Fallback:
        """Calls a reader and returns its result, or ``fallback`` if it raises an error.

        Args:
            fallback: Placeholder with which reading can continue.
            read: The reader, called with the remaining arguments.
            *args: Its arguments.
            **kwargs: Its keyword arguments.

        Raises:
            SceneError: The error, if the stage was opened without a list of mistakes; otherwise it is noted.
        """
        try:
            return read(*args, **kwargs)
        except SceneError as mistake:
            self.collect(mistake)
        except Tf.ErrorException as error:
            self.collect(self._unreadable(error))
        return fallback

    def _unreadable(self, error: BaseException) -> SceneError:
        """Returns USD's own message about something that it cannot read, as an error."""
        what = f"OpenUSD cannot read the file ({usd_reason(error)})"
        return self.error(what, allowed="valid USD", fix="correct the error that OpenUSD reports")

    def error(self, what: str, prim: Usd.Prim | str = "", *, allowed: str = "", fix: str = "") -> SceneError:
        """Creates a :class:`SceneError` at a prim of this file."""
        place = prim if isinstance(prim, str) else prim.GetPath()
        return SceneError(what, file=self.file, prim=place, allowed=allowed, fix=fix)

    def warning(self, what: str, prim: Usd.Prim | str = "", *, allowed: str = "", fix: str = "") -> Problem:
        """Creates a warning at a prim of this file."""
        place = prim if isinstance(prim, str) else str(prim.GetPath())
        return Problem(str(self.file), "warning", place, what, allowed, fix)

    def _check_units(self) -> None:
        """Checks that units are given, since they are converted but never guessed."""
        lengths, masses = UsdGeom.GetStageMetersPerUnit(self.stage), UsdPhysics.GetStageKilogramsPerUnit(self.stage)
        if not UsdGeom.StageHasAuthoredMetersPerUnit(self.stage):
            what = "the unit of length is not given; USD would assume centimetres"
            raise self.error(what, allowed="metersPerUnit", fix="set it at the top of the file: 1 for metres")
        if not self.stage.HasAuthoredMetadata("upAxis"):
            what = "the up axis is not given; USD would assume y"
            raise self.error(what, allowed='upAxis "Y" or "Z"', fix='set it at the top of the file: "Z" for z')
        for name, unit, example in (("metersPerUnit", lengths, "metres"), ("kilogramsPerUnit", masses, "kilograms")):
            if not (np.isfinite(unit) and unit > 0.0):
                fix = f"set it to the unit of the numbers in the file: 1 for {example}"
                raise self.error(f"{name} is {unit:g}", allowed="a finite number above zero", fix=fix)

    def prims(self, root: Usd.Prim | None = None) -> Iterator[Usd.Prim]:
        """Iterates over all active prims below ``root`` (inclusive), those in instances too, in file order."""
        yield from Usd.PrimRange(root or self.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())

    def prims_with(self, schema: str) -> list[Usd.Prim]:
        """Returns the prims with one of the package's API schemas applied."""
        return [prim for prim in self.prims() if schema in prim.GetPrimTypeInfo().GetAppliedAPISchemas()]

    def single_prim(self, schema: str, noun: str, where: str) -> Usd.Prim:
        """Returns the only prim with a role.

        Args:
            schema: Name of the API schema.
            noun: Name of the role in an error.
            where: Where the schema should be applied, for the error.

        Raises:
            SceneError: There is no such prim, or more than one.
        """
        found = self.prims_with(schema)
        if not found:
            fix = f"apply {schema} to {where}"
            raise self.error(f"the scene has no {noun}", allowed=f"exactly one prim with {schema}", fix=fix)
        if len(found) > 1:
            paths = ", ".join(f"<{prim.GetPath()}>" for prim in found)
            what = f"the scene has {len(found)} {noun}s: {paths}"
            raise self.error(what, allowed=f"exactly one prim with {schema}", fix=f"keep {schema} on one of them")
        return found[0]

    def numbers(self, prim: Usd.Prim, name: str, shape: tuple[int, ...], meaning: str) -> np.ndarray:
        """Reads a numeric attribute.

        Args:
            prim: The prim.
            name: Name of the attribute; if it is not authored, the schema's default is used.
            shape: Required shape; -1 allows any number of rows.
            meaning: Description of the required value, for the error.

        Raises:
            SceneError: The value is missing or not numeric, has another shape, or contains NaN; infinity is allowed.
        """
        attribute = prim.GetAttribute(name)
        value = attribute.Get() if attribute and attribute.HasAuthoredValue() else schema_default(name)
        if value is None:
            raise self.error(f"{name} is missing", prim, allowed=meaning, fix="set it; docs/schema.md describes it")
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(())
        if array.size == 0 and -1 in shape:
            array = np.empty([0 if n == -1 else n for n in shape])
        fits = array.ndim == len(shape) and all(n in (-1, got) for n, got in zip(shape, array.shape, strict=True))
        if not fits or np.isnan(array).any():
            raise self.error(f"{name} is {value}", prim, allowed=meaning, fix="see the example in docs/schema.md")
        return array

    def text(self, prim: Usd.Prim, name: str) -> str:
        """Reads a text attribute of the package's schemas; the schema's default if it is not set."""
        attribute = prim.GetAttribute(name)
        return str((attribute.Get() if attribute else None) or schema_default(name))

    def number(self, prim: Usd.Prim, name: str, fallback: float) -> float:
        """Reads a number from an attribute of one of USD's own schemas, or returns ``fallback`` if it has no value.

        Raises:
            SceneError: The value is not a number.
        """
        attribute = prim.GetAttribute(name)
        value = attribute.Get() if attribute else None
        if value is None:
            return fallback
        if isinstance(value, bool) or not isinstance(value, int | float):
            fix = f"declare it with a numeric type, e.g. float {name} = 0.1"
            raise self.error(f"{name} is {value!r}", prim, allowed="a number", fix=fix)
        return shortest_decimal(value)

    def frame(self, prim: Usd.Prim) -> Gf.Matrix4d:
        """Returns a prim's frame in the world in USD's convention (row vectors, scale included) [m].

        Raises:
            SceneError: It has numbers that are too large or not finite.
        """
        frame = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
        if not (np.abs(np.array(frame)) < MAX_LENGTH).all():
            allowed = f"finite numbers, and lengths below {MAX_LENGTH:g} m"
            raise self.error(
                "the transform has values that are too large or not finite",
                prim,
                allowed=allowed,
                fix="correct the xformOps of this prim or of its ancestors",
            )
        return frame

    def body_frame(self, prim: Usd.Prim) -> Gf.Matrix4d:
        """Returns a rigid body's frame in the world, without scale or shear [m].

        A body that is scaled or mirrored is noted as a mistake.

        Raises:
            SceneError: It has numbers that are too large or not finite.
        """
        frame = self.frame(prim)
        if not is_rigid(frame):
            mirrored = " and mirrored" if frame.GetDeterminant() < 0.0 else ""
            self.collect(
                self.error(
                    f"the body is scaled by {format_numbers(scales(frame))}{mirrored}",
                    prim,
                    allowed="(1, 1, 1), without mirroring",
                    fix="scale its shapes instead",
                )
            )
        return frame.GetOrthonormalized()

    def friction(self, prim: Usd.Prim) -> float | None:
        """Returns the coefficient of dynamic friction of a prim's physics material; ``None`` without a material.

        Raises:
            SceneError: It is not a number, negative or not finite.
        """
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        if not material or not material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
            return None
        value = self.number(material.GetPrim(), "physics:dynamicFriction", 0.0)
        if not (np.isfinite(value) and value >= 0.0):
            raise self.error(
                f"physics:dynamicFriction is {value:g}",
                material.GetPrim(),
                allowed="zero or more",
                fix="set it to the coefficient of Coulomb friction",
            )
        return value


def file_of(layer: Sdf.Layer) -> Path:
    """Returns the file that contains a layer; for a layer in a USDZ package, the package."""
    return Path(Ar.SplitPackageRelativePathOuter(layer.realPath)[0])


@cache
def _schema_layer() -> Any:
    return Sdf.Layer.FindOrOpen(str(SCHEMA / "generatedSchema.usda"))


@cache
def schema_default(name: str) -> Any:
    """Returns the default value of an attribute in the package's schema; ``None`` if the attribute is required.

    Raises:
        KeyError: The schema has no such attribute.
    """
    for prim in _schema_layer().rootPrims:
        if name in prim.attributes:
            return prim.attributes[name].default
    raise KeyError(name)


@cache
def schema_attributes() -> dict[str, tuple[str, ...]]:
    """Returns the names of the attributes of each of the package's API schemas, by the schema's name."""
    return {prim.name: tuple(prim.attributes.keys()) for prim in _schema_layer().rootPrims}
