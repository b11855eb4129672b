"""Checks that a stage's properties have the kinds and types given by their schemas, before anything reads them.

USD itself accepts a string as a mass, or an attribute in place of a relationship; a reader then receives a value of the
wrong type.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pxr import Gf, Sdf, Tf, Usd, UsdGeom


@dataclass(frozen=True)
class InvalidProperty:
    """An unreadable property: its path, the value found, what is allowed, and the remedy."""

    prim: Usd.Prim
    what: str
    allowed: str
    fix: str = "declare it as its schema does, or remove it"


def invalid_properties(stage: Usd.Stage) -> Iterator[InvalidProperty]:
    """Yields properties that do not conform to their schemas, and transforms that USD cannot compute."""
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        definition, found = prim.GetPrimDefinition(), list[InvalidProperty]()
        for name in prim.GetAuthoredPropertyNames():
            wanted = definition.GetSchemaPropertySpec(name)
            if wanted is not None and not name.startswith("oimppi:"):  # their readers report more detail
                found += _type_mismatch(prim, name, wanted)
        if prim.IsA(UsdGeom.Xformable) and not found:
            found += _invalid_transform(prim)
        yield from found


def usd_reason(error: BaseException) -> str:
    """Returns the reason given in a USD exception, whose text is a list of locations in USD's own source."""
    try:
        text = str(error)
    except UnicodeDecodeError as undecoded:  # it quotes the bytes that it could not decode
        text = undecoded.object.decode(errors="replace")
    return text.partition(" : ")[2].split("\n")[0].strip(" '")


def _type_mismatch(prim: Usd.Prim, name: str, wanted: Sdf.PropertySpec) -> Iterator[InvalidProperty]:
    try:
        found = prim.GetProperty(name).GetPropertyStack(Usd.TimeCode.Default())
    except Tf.ErrorException as error:
        yield InvalidProperty(
            prim, f"{name} cannot be read ({usd_reason(error)})", "the same kind of property in all layers"
        )
        return
    for spec in found:
        if type(spec) is not type(wanted):
            kind = "an attribute" if isinstance(wanted, Sdf.AttributeSpec) else "a relationship"
            yield InvalidProperty(prim, f"{name} is not {kind}", f"{kind}, as defined by its schema")
            return
        if isinstance(wanted, Sdf.AttributeSpec) and _kind(spec.typeName) != _kind(wanted.typeName):
            yield InvalidProperty(prim, f"{name} is of type {spec.typeName}", str(wanted.typeName))
            return
    value = prim.GetAttribute(name).Get() if isinstance(wanted, Sdf.AttributeSpec) else None
    if value is not None and type(value) is not type(found[0].typeName.defaultValue):
        yield InvalidProperty(prim, f"{name} is {value!r}", f"a {wanted.typeName}")


def _kind(type_name: Sdf.ValueTypeName) -> tuple[str, bool]:
    """Returns the kind of value a type holds, at any precision: a number, text, a vector of three numbers and so on."""
    value = type_name.scalarType.defaultValue
    if isinstance(value, bool):
        kind = "bool"
    elif isinstance(value, int):
        kind = "integer"
    elif isinstance(value, float):
        kind = "number"
    elif isinstance(value, str):
        kind = "words"
    elif isinstance(value, Gf.Quath | Gf.Quatf | Gf.Quatd):
        kind = "quaternion"
    elif hasattr(value, "__len__"):
        kind = f"{len(value)} numbers"
    else:
        kind = type(value).__name__
    return kind, type_name.isArray


def _invalid_transform(prim: Usd.Prim) -> Iterator[InvalidProperty]:
    """Yields transforms that USD would compute without the operations that it cannot interpret."""
    allowed = "names of xformOp attributes of this prim, each with the type of its operation"
    fix = "correct xformOpOrder"
    order = UsdGeom.Xformable(prim).GetXformOpOrderAttr().Get() or []
    for name in (word.removeprefix("!invert!") for word in order if word != "!resetXformStack!"):
        if not name.startswith("xformOp:") or not prim.HasAttribute(name):
            yield InvalidProperty(
                prim, f"xformOpOrder lists {name}, which is not an operation of this prim", allowed, fix
            )
            return
    try:
        UsdGeom.Xformable(prim).GetOrderedXformOps()
    except Tf.ErrorException as error:
        yield InvalidProperty(prim, f"xformOpOrder cannot be evaluated ({usd_reason(error)})", allowed, fix)
