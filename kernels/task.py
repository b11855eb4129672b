"""The robot level's task in the form read by every engine's kernels, and the part of the stage that they share."""

import warp as wp

from oimppi_warp.kernels.costs.terms import CROSSING, RobotWeights, Stage
from oimppi_warp.kernels.geometry import PoseField, pose_field
from oimppi_warp.kernels.kinematics import Arm, ArmPlacement, Environment
from oimppi_warp.kernels.pushing import ObjectModel, phi_1

wp.set_module_options({"enable_backward": False})


@wp.struct
class RobotTask:
    """The robot level's task: arm, object, environment, targets and weights.

    Attributes:
        arm: The arm.
        model: The pushed object.
        environment: Obstacles and table, which the arm must keep clear of.
        weights: Weights of the cost terms.
        to_go: Cost-to-go of the object [m]; not read if ``w_to_go`` is zero.
        goal: The object's goal, a pose, shape [1].
        reference: Poses of the object plan at each step from now, shape [horizon + 1 + align_ahead].
        waypoint: Waypoint of the tip while it is repositioned, shape [1], see ``Stage``.
        dt: Control period [s].
    """

    arm: Arm
    model: ObjectModel
    environment: Environment
    weights: RobotWeights
    to_go: PoseField
    goal: wp.array[wp.vec3]
    reference: wp.array[wp.vec3]
    waypoint: wp.array[wp.vec4]
    dt: float


@wp.func
def over_object(task: RobotTask, tip: wp.vec3, pose: wp.vec3) -> bool:
    """Returns whether the tool is over the object, seen from above."""
    return phi_1(task.model, pose, wp.vec2(tip[0], tip[1])) < task.environment.tool_radius


@wp.func
def above_penalty(task: RobotTask, tip: wp.vec3) -> float:
    """Returns 1 for a tip over the object, else 0; while repositioning, a tip ``CROSSING`` above it does not count."""
    counts = float(0.0)
    if task.waypoint[0][3] <= 0.0 or tip[2] < task.model.top + CROSSING:
        counts = 1.0
    return counts


@wp.func
def stage_at(task: RobotTask, h: int, placed: ArmPlacement, pose: wp.vec3) -> Stage:
    """Returns the stage after control step ``h`` with the fields that follow from arm and object; the rest is zero."""
    stage = Stage()
    stage.tip = placed.tip
    stage.up = placed.up
    stage.lean = placed.lean
    stage.pose = pose
    stage.top = task.model.top
    stage.goal = task.goal[0]
    stage.reference = task.reference[h + 1]
    stage.target = task.reference[h + 1 + task.weights.align_ahead]
    stage.waypoint = task.waypoint[0]
    if task.weights.w_to_go > 0.0:
        stage.to_go = pose_field(task.to_go, pose)[0]
    return stage
