"""Resolves settings for a task: computes the values that take effect, once, before anything is built from them.

Some settings depend on the robot and on the object: they are given for the xArm6 and for any object, and take effect
with other values. :func:`resolve` is the only place where they are converted; planners use, and records hold, the
resolved settings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from oimppi_warp.config.overrides import effective_weights, options
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ConfigError
from oimppi_warp.geometry.reach import Reach, reach_of
from oimppi_warp.geometry.tipping import can_tip, tipping_height
from oimppi_warp.registries import COST_TERMS, ENGINES, METHODS, OPTIMIZERS, PLANTS
from oimppi_warp.registry import Registry
from oimppi_warp.scene import Scene

_USUAL_REACH = 0.717
"""Reach of the xArm6 with its stick, for which ``cost.push_ring`` and ``object_cost.push_ring`` are given [m]."""
_EVERYWHERE = 1e3
"""Outer radius of a ring that excludes nothing [m]."""
_PUSHED_AT = 0.6
"""Height of a push, at most, as a share of that at which it tips the object over."""
_STRIDE = 1.35
"""Length of a step of the contact model, at most, per radius of the tool: a longer one leads through thin objects."""
_THIN = 0.05
"""Tipping height below which it matters how low an object is pushed [m]."""


@dataclass(frozen=True)
class Change:
    """A setting that takes effect with a value other than the requested one.

    Attributes:
        asked: The requested value.
        reason: Short reason why it is not used.
    """

    asked: Any
    reason: str


@dataclass(frozen=True)
class Resolved:
    """Settings as they take effect.

    Attributes:
        config: The effective settings; ``resolved_for`` describes the task.
        changes: Changes to the requested settings, by dotted names.
    """

    config: Config
    changes: dict[str, Change]


def resolve(config: Config, scene: Scene, *, control_period: float | None = None) -> Resolved:
    """Resolves settings for a task.

    - ``cost.push_ring`` and ``object_cost.push_ring`` are scaled to the robot's own reach.
    - If the goal's tolerance allows every yaw, costs of yaw are off.
    - Costs that keep an object from tipping over are off for an object that a push cannot tip.
    - An object that a push at the height ``cost.height`` could tip over is pushed lower.
    - A plant with a fixed control period determines ``control_period``; ``object.optimizer.horizon`` is changed so that
      the object level plans as far ahead in time.
    - The contact model takes more steps if the tip could otherwise pass through an object between two of them.
    - The weights of cost terms from outside the package are filled in.

    Settings that are resolved already are returned as they are, with no changes, so that nothing is scaled twice.

    Args:
        config: The requested settings.
        scene: The task; start, goal and obstacles do not matter.
        control_period: The plant's control period, if it is fixed [s].

    Raises:
        ConfigError: The settings were resolved for another kind of task, whose values would be wrong here.
    """
    reach, tips, tips_from = reach_of(scene.robot), can_tip(scene.object), tipping_height(scene.object)
    task = _task(reach, any_yaw=not math.isfinite(scene.tolerance.yaw), tips=tips, tips_from=tips_from)
    if config.resolved_for not in ("", task):
        raise ConfigError(
            f"the settings were resolved for another task: {config.resolved_for}; {scene.name} is: {task}\n"
            "  to do:   pass the original settings, before they were resolved"
        )
    reasons: dict[str, str] = {}
    effective = config
    if not config.resolved_for:
        effective = replace(_for_reach(config, reach), resolved_for=task)
        why = (
            f"the robot reaches {reach.radius:.2f} m"
            if reach.border is None or reach.disc
            else "the robot does not turn about a base"
        )
        reasons |= {"cost.push_ring": why, "object_cost.push_ring": why}
        if not math.isfinite(scene.tolerance.yaw):
            effective = _without_yaw(effective)
            names = ("object.turn", "cost.w_theta", "object_cost.w_theta")
            reasons |= dict.fromkeys(names, "the tolerance allows every yaw")
        if not tips:
            effective = replace(effective, cost=replace(effective.cost, w_overhang=0.0, w_rush=0.0))
            reasons |= dict.fromkeys(("cost.w_overhang", "cost.w_rush"), "a push cannot tip the object")
        lower = _PUSHED_AT * tips_from
        if tips and 0.0 < lower < effective.cost.height:
            effective = replace(effective, cost=replace(effective.cost, height=lower))
            reasons["cost.height"] = f"a push from {1000 * tips_from:.0f} mm above the table tips the object over"
        effective = replace(effective, cost=replace(effective.cost, extra=effective_weights(effective.cost)))
    if control_period is not None and control_period != config.control_period:
        effective = _with_period(effective, control_period)
        reasons["control_period"] = "the plant has a fixed control period"
        reasons["object.optimizer.horizon"] = f"the plant's control period is {control_period:g} s"
    if not config.resolved_for or effective.control_period != config.control_period:
        effective = _with_short_contact_steps(effective, scene.robot.tool_radius)
        reasons["robot.contact_steps"] = f"the tool's radius is {1000 * scene.robot.tool_radius:.3g} mm"
    asked, used = options(config), options(effective)
    changes = {name: Change(asked[name], why) for name, why in reasons.items() if asked[name] != used[name]}
    return Resolved(effective, changes)


def entries_used(spec: RunSpec, config: Config) -> list[tuple[Registry[Any], str]]:
    """Returns the registry entries that a run uses, except an engine that is chosen automatically."""
    used: list[tuple[Registry[Any], str]] = [(METHODS, spec.method), (PLANTS, spec.plant)]
    used += [(ENGINES, spec.engine)] * (spec.engine != "auto")
    used += [(OPTIMIZERS, level.optimizer.kind) for level in (config.robot, config.object)]
    used += [(COST_TERMS, name) for name, weight in effective_weights(config.cost).items() if weight != 0.0]
    return used


def _task(reach: Reach, *, any_yaw: bool, tips: bool, tips_from: float) -> str:
    """Describes the properties of a task that settings depend on."""
    tipping = "can tip" if tips else "cannot tip"
    if tips and tips_from < _THIN:
        tipping = f"tips from {1000 * tips_from:.0f} mm"
    ring = f"reach x{_scale(reach):g}" if reach.border is None else "no ring of reach"
    if reach.disc:
        ring = f"reach x{_scale(reach):g}, {reach.offset:.2f} m beside the base"
    return ", ".join([ring, "any yaw" if any_yaw else "yaw counts", tipping])


def _scale(reach: Reach) -> float:
    """Returns a robot's reach relative to that of the xArm6, rounded to hundredths."""
    return round((reach.disc or reach.radius) / _USUAL_REACH, 2)


def _for_reach(config: Config, reach: Reach) -> Config:
    """Returns the settings with the rings scaled to a robot's reach."""

    def ring(given: tuple[float, float]) -> tuple[float, float]:
        # Around the base, but within the ring around the axis in front of the arm.
        inner, outer = _scale(reach) * given[0] + reach.offset, _scale(reach) * given[1]
        turns = reach.border is None or reach.disc > 0.0
        return (inner, outer) if turns and inner < outer else (0.0, _EVERYWHERE)

    return replace(
        config,
        cost=replace(config.cost, push_ring=ring(config.cost.push_ring)),
        object_cost=replace(config.object_cost, push_ring=ring(config.object_cost.push_ring)),
    )


def _with_period(config: Config, period: float) -> Config:
    """Returns the settings with another control period [s], and an object level that plans as far ahead in time."""
    level = config.object
    least = max(level.optimizer.knots, 1)
    horizon = max(round(level.optimizer.horizon * config.control_period / period), least)
    optimizer = replace(level.optimizer, horizon=horizon)
    return replace(config, control_period=period, object=replace(level, optimizer=optimizer))


def _with_short_contact_steps(config: Config, tool_radius: float) -> Config:
    """Returns the settings with as many steps of the contact model as the tip's largest speed requires."""
    level = config.robot
    if level.controls != "tool":
        return config
    way = math.hypot(level.tip_speed_limit, level.tip_speed_limit) * config.control_period
    needed = math.ceil(way / (_STRIDE * tool_radius))
    return replace(config, robot=replace(level, contact_steps=max(level.contact_steps, needed)))


def _without_yaw(config: Config) -> Config:
    """Returns the settings without any cost of the object's yaw."""
    return replace(
        config,
        object=replace(config.object, turn=False),
        cost=replace(config.cost, w_theta=0.0),
        object_cost=replace(config.object_cost, w_theta=0.0),
    )
