"""Makes the plant that a run asks for, with its options."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, get_args, get_type_hints

from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.plants.plant import Plant, has_own_world
from oimppi_warp.registries import PLANTS
from oimppi_warp.scene import Scene
from oimppi_warp.suggestions import did_you_mean

_GIVEN = ("scene", "config", "seed")
_TEXTUAL = {str, int, float, bool}
"""Types of options that can be given as text."""
_TRUE, _FALSE = ("true", "1", "yes"), ("false", "0", "no")


def make_plant(scene: Scene, config: Config, spec: RunSpec) -> Plant:
    """Makes the plant of a run.

    Args:
        scene: The task.
        config: All settings.
        spec: The options of the run; ``plant``, ``plant_options``, ``friction`` and ``seed`` are used.

    Raises:
        ConfigError: There is no such plant, it cannot be made, or it has no such option.
    """
    make = PLANTS.get_checked(spec.plant)
    if spec.friction is not None:
        if has_own_world(make):
            raise ConfigError(f"--friction {spec.friction:g}: the plant {spec.plant} has a friction of its own")
        scene = replace(scene, object=replace(scene.object, friction=spec.friction))
    positional, named = _task_arguments(spec.plant, make, {"scene": scene, "config": config, "seed": spec.seed})
    if spec.plant_options:
        named |= plant_options(make, spec.plant, spec.plant_options)
    try:
        inspect.signature(make).bind(*positional, **named)
    except TypeError as error:
        raise ConfigError(
            f"the plant {spec.plant} cannot be made: {error}\n"
            "  allowed: the arguments scene, config and seed, or some of them; others need a default or --plant-options"
        ) from None
    return make(*positional, **named)


def starts_itself(plant: str) -> bool:
    """Returns whether the plant with a name places arm and object itself, by the seed alone.

    Raises:
        ConfigError: There is no such plant.
    """
    return has_own_world(PLANTS.get_checked(plant))


def plant_options(make: Callable[..., Plant], name: str, assignments: Sequence[str]) -> dict[str, Any]:
    """Converts options of a plant, ``NAME=VALUE``, to arguments of the function or class that makes it.

    The options of a plant are the keyword arguments of that function besides ``scene``, ``config`` and ``seed``. They
    may be text, numbers or truth values.

    Args:
        make: The entry of the registry.
        name: Its name.
        assignments: The options.

    Raises:
        ConfigError: The plant has no such option, or the value is not of its type.
    """
    known = {key: kind for key, kind in _types(make).items() if key not in _GIVEN and {*_kinds(kind)} & _TEXTUAL}
    found: dict[str, Any] = {}
    for assignment in assignments:
        key, _, text = assignment.partition("=")
        if key not in known:
            near = did_you_mean(key, known)
            hint = f"\n  to do:   {near}" if near else ""
            allowed = ", ".join(known) or "none"
            raise ConfigError(f"--plant-options {key}: the plant {name} has no such option\n  allowed: {allowed}{hint}")
        try:
            found[key] = _value(text, known[key])
        except ValueError:
            kinds = " or ".join(kind.__name__ for kind in _kinds(known[key]))
            raise ConfigError(f"--plant-options {assignment}: not a value of this option\n  allowed: {kinds}") from None
    return found


def _task_arguments(name: str, make: Any, given: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Returns those of scene, config and seed that a function takes: by name, or scene and config as its first ones.

    Args:
        name: Name of the plant.
        make: The function or class that makes it.
        given: Scene, config and seed by name.

    Raises:
        ConfigError: It is neither a function nor a class.
    """
    try:
        parameters = inspect.signature(make).parameters.values()
    except (TypeError, ValueError):
        raise ConfigError(f"the plant {name} is neither a function nor a class") from None
    kinds = inspect.Parameter
    named = {each.name for each in parameters if each.kind in (kinds.POSITIONAL_OR_KEYWORD, kinds.KEYWORD_ONLY)}
    positional = []
    if "scene" not in named:
        unnamed = (kinds.POSITIONAL_ONLY, kinds.POSITIONAL_OR_KEYWORD)
        first = [each for each in parameters if each.kind in unnamed and each.default is kinds.empty]
        anything = any(each.kind is kinds.VAR_POSITIONAL for each in parameters)
        positional = ["scene", "config"][: 2 if anything else len(first)]
    if any(each.kind is kinds.VAR_KEYWORD for each in parameters):
        named.add("seed")
    return [given[each] for each in positional], {
        each: value for each, value in given.items() if each in named and each not in positional
    }


def _types(make: Callable[..., Plant]) -> dict[str, Any]:
    """Returns the type of each argument by name; that of an argument without annotation is ``str``."""
    function = make.__init__ if inspect.isclass(make) else make
    try:
        hints = get_type_hints(function)
    except (NameError, TypeError):  # types that are imported for type checkers only
        hints = {}
    parameters = inspect.signature(make).parameters.values()
    named = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return {each.name: hints.get(each.name, str) for each in parameters if each.kind in named}


def _kinds(hint: Any) -> list[type]:
    """Returns the types that a hint allows, without ``None``."""
    options = get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    return [option for option in options if isinstance(option, type) and option is not type(None)]


def _value(text: str, hint: Any) -> Any:
    """Converts text to the first type of a hint that takes it; raises ValueError if none does."""
    for kind in _kinds(hint):
        if kind is bool:
            if text.lower() in (*_TRUE, *_FALSE):
                return text.lower() in _TRUE
            continue
        if kind in (int, float, str):
            try:
                return kind(text)
            except ValueError:
                continue
    raise ValueError(text)
