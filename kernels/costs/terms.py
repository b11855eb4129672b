"""The stage that the robot level's cost terms read, and the stage cost composed of them.

A term is a function of the weights and of the :class:`Stage`, the result of one control step of a rollout. The built-in
ones are in ``kernels/costs/stage_costs.py``; those from outside the package are :class:`oimppi_warp.CostTerm`.
"""

from collections.abc import Sequence
from typing import Any, get_type_hints

import warp as wp

from oimppi_warp.config.settings import RobotCost
from oimppi_warp.kernels.options import fast, fast_module

wp.set_module_options({"enable_backward": False})

NOT_PUSHED = wp.constant(1.0)
"""Clearance of an object that is not being pushed, for costs [m]."""

CROSSING = wp.constant(0.01)
"""Height above the object's top from which a tip may cross it while it is repositioned [m]."""

ExtraTerms = tuple[tuple[str, wp.Function], ...]
"""Cost terms from outside the package: names, and functions ``(s: Stage) -> float`` of the unweighted cost."""

_PACKED = {float: float, int: int, tuple[float, float]: wp.vec2}
"""Types of settings that kernels read, and the corresponding types in kernels."""


def weights_struct(name: str, settings: type, **more: type) -> Any:
    """Makes a Warp struct of a settings dataclass's numbers and pairs of numbers, with ``more`` fields."""
    fields = {key: _PACKED[kind] for key, kind in get_type_hints(settings).items() if kind in _PACKED}
    about = f"``oimppi_warp.config.settings.{settings.__name__}`` as read by the kernels."
    return wp.struct(type(name, (), {"__module__": __name__, "__doc__": about, "__annotations__": fields | more}))


RobotWeights = weights_struct(
    "RobotWeights",
    RobotCost,
    edge_lower=wp.vec2,
    edge_upper=wp.vec2,
    topple_speed=float,
    size=float,
    extra=wp.array[float],
)
"""Weights of the robot level: the fields of ``oimppi_warp.config.settings.RobotCost``, and the following.

Attributes:
    edge_lower, edge_upper: Corners of the rectangle within which the object's centre keeps all of it on the table [m].
    topple_speed: Speed above which approaching an object that may tip over costs [m/s].
    size: Largest distance of the object's outline from its centre [m].
    extra: Weights of the terms from outside the package, shape [extra term].
"""


@wp.struct
class Stage:
    """Result of one control step of a rollout, as used by the robot level's cost terms.

    Attributes:
        tip: Position of the tool tip in the world frame [m].
        up: The world's z axis in the tip's frame.
        lean: Tilt of the stick; see ``ArmPlacement``.
        velocity: Velocity of the tip in x and y [m/s].
        pose: Planar pose of the object's friction centre [m, m, rad].
        top: Height of the object's top above the table [m].
        goal: Goal of the friction centre [m, m, rad].
        reference: Pose of the reference at this step [m, m, rad].
        target: Pose of the reference ``align_ahead`` steps later, for the alignment [m, m, rad].
        to_go: Cost-to-go of the pose [m]; 0 if its weight is zero.
        stance: Remaining way of the tool to a place from which it pushes the object towards the target [m]; 0 if its
            weight is zero.
        force: Contact force between object and environment, lambda_2 [N].
        arm_clearance: Clearance of arm and tool to obstacles and table, phi_3 [m].
        above: 1 if the tip is above the object, else 0.
        pressed: Depth to which the tool presses into an object that cannot yield [m].
        gap: Clearance phi_2 of the pose to which the tool pushes the object; ``NOT_PUSHED`` if it does not push [m].
        rise: Speed at which the tip rises while it pushes [m/s].
        speed_squared: Squared norm of the joint velocities [rad^2/s^2] or, in rollouts of an upright arm, of the tip's
            velocity [m^2/s^2].
        collision: Contact force between robot and environment, lambda_3 [N].
        waypoint: Waypoint of the tip while repositioning (x, y, z [m]) and its weight [1/m^2], zero for none.
    """

    tip: wp.vec3
    up: wp.vec3
    lean: wp.vec2
    velocity: wp.vec2
    pose: wp.vec3
    top: float
    goal: wp.vec3
    reference: wp.vec3
    target: wp.vec3
    to_go: float
    stance: float
    force: float
    arm_clearance: float
    above: float
    pressed: float
    gap: float
    rise: float
    speed_squared: float
    collision: float
    waypoint: wp.vec4


def module_of(name: str, extra: ExtraTerms) -> dict[str, Any]:
    """Returns arguments for ``wp.kernel`` that give a rollout kernel its module, and one with extra terms its own name.

    With extra terms, the module's name contains their names and ends with a hash of everything that is compiled.
    """
    if not extra:
        return {"module": fast_module(name)}
    name = "_".join((name, *(key for key, _ in extra)))
    return {"name": name, "module": "unique", "module_options": fast()}


def compose(terms: Sequence[wp.Function], extra: ExtraTerms) -> wp.Function:
    """Composes a function ``(w: RobotWeights, s: Stage)`` that returns a vector with the weighted cost of each term.

    Args:
        terms: Functions ``(w: RobotWeights, s: Stage) -> float``.
        extra: Terms that follow, whose weights are ``w.extra``.
    """
    vector = wp.types.vector(length=len(terms) + len(extra), dtype=float)

    @wp.func(name="cost_of_no_terms", module="oimppi_warp.kernels.robot_cost")
    def no_terms(w: RobotWeights, s: Stage) -> vector:
        return vector()

    # Functions are nested: with wp.static in a loop over the terms, a module's hash would depend on what was
    # compiled before it.
    cost = no_terms
    for index, weighted in enumerate((*terms, *(_weighted(function, i) for i, (_, function) in enumerate(extra)))):
        cost = _with_term(cost, weighted, index, vector)
    return cost


def _weighted(function: wp.Function, index: int) -> wp.Function:
    """Returns a term from outside the package multiplied by its weight, ``w.extra[index]``."""

    @wp.func(name=f"weighted_{index}", module="oimppi_warp.kernels.robot_cost")
    def weighted(w: RobotWeights, s: Stage) -> float:
        return w.extra[index] * function(s)

    return weighted


def _with_term(cost: wp.Function, added: wp.Function, index: int, vector: type) -> wp.Function:
    """Returns a stage cost with one more term, at ``index``."""

    @wp.func(name=f"cost_of_{index + 1}_terms", module="oimppi_warp.kernels.robot_cost")
    def with_term(w: RobotWeights, s: Stage) -> vector:
        terms = cost(w, s)
        terms[index] = added(w, s)
        return terms

    return with_term
