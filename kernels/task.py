"""The robot level's task in the form read by every engine's kernels, and the part of the stage that they share."""

import warp as wp

from oimppi_warp.kernels.costs.terms import CROSSING, RobotWeights, Stage
from oimppi_warp.kernels.fields.cost_to_go import HOME, distance_to_go, turned_distance
from oimppi_warp.kernels.fields.stance import StanceField, stance_field
from oimppi_warp.kernels.geometry import PoseField, pose_field, rotate, wrap_angle
from oimppi_warp.kernels.kinematics import Arm, ArmPlacement, Environment
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.kernels.upright import UprightArm

wp.set_module_options({"enable_backward": False})


@wp.struct
class RobotTask:
    """The robot level's task: arm, object, environment, targets and weights.

    Attributes:
        arm: The arm.
        upright: The arm with its tool upright; not read if the controls are joint velocities.
        model: The pushed object.
        environment: Obstacles and table, which the arm must keep clear of.
        weights: Weights of the cost terms.
        to_go: Cost-to-go of the object [m]; not read if ``w_to_go`` is zero.
        yaw_length: Length that a radian of yaw counts as in the cost-to-go [m].
        stance: Remaining way of the tool to a good place [m]; not read if ``w_stance`` is zero.
        goal: The object's goal, a pose, shape [1].
        reference: Poses of the object plan at each step from now, shape [horizon + 1 + align_ahead].
        waypoint: Waypoint of the tip while it is repositioned, shape [1], see ``Stage``.
        dt: Control period [s].
    """

    arm: Arm
    upright: UprightArm
    model: ObjectModel
    environment: Environment
    weights: RobotWeights
    to_go: PoseField
    yaw_length: float
    stance: StanceField
    goal: wp.array[wp.vec3]
    reference: wp.array[wp.vec3]
    waypoint: wp.array[wp.vec4]
    dt: float


@wp.func
def above_penalty(task: RobotTask, tip: wp.vec3) -> float:
    """Returns 1 for a tip over the object, else 0; while repositioning, a tip ``CROSSING`` above it does not count."""
    counts = float(0.0)
    if task.waypoint[0][3] <= 0.0 or tip[2] < task.model.top + CROSSING:
        counts = 1.0
    return counts


@wp.func
def wanted_motion(task: RobotTask, pose: wp.vec3, target: wp.vec3) -> wp.vec3:
    """Returns the direction in which the object should move: (x, y, yaw), of any length.

    It is that to the target or, where the object is led by the cost-to-go and not yet close to the goal, the steepest
    descent of the cost-to-go. Where the yaw does not matter, it is zero.
    """
    motion = target - pose
    motion[2] = wrap_angle(motion[2])
    if task.weights.w_theta <= 0.0:
        motion[2] = 0.0
    if task.weights.w_to_go > 0.0 and turned_distance(pose, task.goal[0], task.yaw_length) > HOME:
        field = pose_field(task.to_go, pose)
        motion = -wp.vec3(field[1], field[2], 0.0)
        if task.weights.w_theta > 0.0:
            motion[2] = -field[3] / (task.yaw_length * task.yaw_length)
    return motion


@wp.func
def stance_at(task: RobotTask, tip: wp.vec3, pose: wp.vec3, target: wp.vec3) -> float:
    """Returns the remaining way of the tool to a place from which it pushes the object towards the target [m]."""
    c = wp.cos(pose[2])
    s = wp.sin(pose[2])
    motion = wanted_motion(task, pose, target)
    along = rotate(c, -s, wp.vec2(motion[0], motion[1]))
    tool = rotate(c, -s, wp.vec2(tip[0] - pose[0], tip[1] - pose[1]))
    return stance_field(task.stance, tool, wp.vec3(along[0], along[1], motion[2]))


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
        stage.to_go = distance_to_go(pose_field(task.to_go, pose)[0], pose, stage.goal, task.yaw_length)
    if task.weights.w_stance > 0.0 and stage.waypoint[3] <= 0.0:
        stage.stance = stance_at(task, placed.tip, pose, stage.target)
    return stage
