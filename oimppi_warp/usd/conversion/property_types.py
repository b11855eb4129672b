"""Whether a stage's properties are of the kinds and types that their schemas want, before anything reads them.

USD itself takes a string for a mass, and an attribute for a relationship; who then asks for it gets whatever is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pxr import Gf, Sdf, Tf, Usd, UsdGeom


@dataclass(frozen=True)
class InvalidProperty:
    """A property that cannot be read: where, what was found, what is allowed, what to do."""

    prim: Usd.Prim
    what: str
    allowed: str
    fix: str = "write it as its schema says, or take it out"


def invalid_properties(stage: Usd.Stage) -> Iterator[InvalidProperty]:
    """Properties that are not what their schemas say, and places that USD cannot compute."""
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        definition, found = prim.GetPrimDefinition(), list[InvalidProperty]()
        for name in prim.GetAuthoredPropertyNames():
            wanted = definition.GetSchemaPropertySpec(name)
            if wanted is not None and not name.startswith("oimppi:"):  # whose readers say more
                found += _type_mismatch(prim, name, wanted)
        if prim.IsA(UsdGeom.Xformable) and not found:
            found += _invalid_transform(prim)
        yield from found


def usd_reason(error: BaseException) -> str:
    """The reason in an exception of USD's, whose text is a list of places in USD's own source."""
    try:
        text = str(error)
    except UnicodeDecodeError as undecoded:  # it quotes what it could not read
        text = undecoded.object.decode(errors="replace")
    return text.partition(" : ")[2].split("\n")[0].strip(" '")


def _type_mismatch(prim: Usd.Prim, name: str, wanted: Sdf.PropertySpec) -> Iterator[InvalidProperty]:
    try:
        found = prim.GetProperty(name).GetPropertyStack(Usd.TimeCode.Default())
    except Tf.ErrorException as error:
        yield InvalidProperty(
            prim, f"{name} cannot be read ({usd_reason(error)})", "one kind of property in all layers"
        )
        return
    for spec in found:
        if type(spec) is not type(wanted):
            kind = "an attribute" if isinstance(wanted, Sdf.AttributeSpec) else "a relationship"
            yield InvalidProperty(prim, f"{name} is not {kind}", f"{kind}, as its schema says")
            return
        if isinstance(wanted, Sdf.AttributeSpec) and _kind(spec.typeName) != _kind(wanted.typeName):
            yield InvalidProperty(prim, f"{name} is of type {spec.typeName}", str(wanted.typeName))
            return
    value = prim.GetAttribute(name).Get() if isinstance(wanted, Sdf.AttributeSpec) else None
    if value is not None and type(value) is not type(found[0].typeName.defaultValue):
        yield InvalidProperty(prim, f"{name} is {value!r}", f"a {wanted.typeName}")


def _kind(type_name: Sdf.ValueTypeName) -> tuple[str, bool]:
    """What a type holds, whatever its precision: a number, words, a vector of three numbers and the like."""
    value = type_name.scalarType.defaultValue
    if isinstance(value, bool):
        kind = "bool"
    elif isinstance(value, int):
        kind = "whole number"
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
    """A place that USD would compute without the operations that it cannot follow."""
    allowed = "names of xformOp attributes of this prim, each of the type of its operation"
    fix = "correct xformOpOrder"
    order = UsdGeom.Xformable(prim).GetXformOpOrderAttr().Get() or []
    for name in (word.removeprefix("!invert!") for word in order if word != "!resetXformStack!"):
        if not name.startswith("xformOp:") or not prim.HasAttribute(name):
            yield InvalidProperty(prim, f"xformOpOrder names {name}, which is no operation here", allowed, fix)
            return
    try:
        UsdGeom.Xformable(prim).GetOrderedXformOps()
    except Tf.ErrorException as error:
        yield InvalidProperty(prim, f"xformOpOrder cannot be followed ({usd_reason(error)})", allowed, fix)
