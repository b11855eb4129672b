# type: ignore  # kernels are Warp, not Python
"""Kernels that call one ``wp.func`` each, a case a thread, so that tests can compare it with its twin.

No ``from __future__ import annotations`` here: Warp reads the annotations.
"""

import warp as wp

from oimppi_warp.kernels.costs.stage_costs import ObjectWeights, make_robot_cost, object_cost, terms_vector
from oimppi_warp.kernels.costs.terms import RobotWeights, Stage
from oimppi_warp.kernels.fields.distance import Pieces, piece_distance
from oimppi_warp.kernels.geometry import (
    PlanarField,
    PoseField,
    SpaceField,
    angle_of,
    planar_field,
    pose_field,
    space_field,
    wrap_angle,
)
from oimppi_warp.kernels.kinematics import turn_about_z
from oimppi_warp.kernels.pushing import ObjectModel, push, settle

wp.set_module_options({"enable_backward": False})


CostTerms = terms_vector()
robot_cost = make_robot_cost(())


@wp.struct
class ObjectCase:
    """The arguments of ``object_cost`` after its weights."""

    pose: wp.vec3
    goal: wp.vec3
    force: float
    clearance: float
    to_go: float


@wp.kernel
def angle_of_probe(points: wp.array[wp.vec2], out: wp.array[float]):
    i = wp.tid()
    out[i] = angle_of(points[i][1], points[i][0])


@wp.kernel
def wrap_angle_probe(angles: wp.array[float], out: wp.array[float]):
    n = wp.tid()
    out[n] = wrap_angle(angles[n])


@wp.kernel
def turn_about_z_probe(matrices: wp.array[wp.mat33], angles: wp.array[float], out: wp.array[wp.mat33]):
    n = wp.tid()
    out[n] = turn_about_z(matrices[n], wp.cos(angles[n]), wp.sin(angles[n]))


@wp.kernel
def planar_field_probe(field: PlanarField, points: wp.array[wp.vec2], out: wp.array[wp.vec3]):
    n = wp.tid()
    out[n] = planar_field(field, points[n])


@wp.kernel
def pose_field_probe(field: PoseField, poses: wp.array[wp.vec3], out: wp.array[wp.vec4]):
    n = wp.tid()
    out[n] = pose_field(field, poses[n])


@wp.kernel
def space_field_probe(field: SpaceField, points: wp.array[wp.vec3], out: wp.array[float]):
    n = wp.tid()
    out[n] = space_field(field, points[n])


@wp.kernel
def piece_distance_probe(
    a: Pieces, poses_a: wp.array[wp.vec3], b: Pieces, poses_b: wp.array[wp.vec3], out: wp.array[float]
):
    n = wp.tid()
    out[n] = piece_distance(a, 0, poses_a[n], b, 0, poses_b[n])


@wp.kernel
def push_probe(
    model: ObjectModel,
    poses: wp.array[wp.vec3],
    starts: wp.array[wp.vec2],
    ends: wp.array[wp.vec2],
    tool_radius: float,
    out: wp.array[wp.vec3],
):
    n = wp.tid()
    out[n] = push(model, poses[n], starts[n], ends[n], tool_radius)


@wp.kernel
def settle_probe(
    model: ObjectModel,
    poses: wp.array[wp.vec3],
    dt: float,
    settled: wp.array[wp.vec3],
    force: wp.array[float],
    clearance: wp.array[float],
):
    n = wp.tid()
    found = settle(model, poses[n], dt)
    settled[n] = found.pose
    force[n] = found.force
    clearance[n] = found.clearance


@wp.kernel
def object_cost_probe(weights: ObjectWeights, cases: wp.array[ObjectCase], out: wp.array[float]):
    n = wp.tid()
    case = cases[n]
    out[n] = object_cost(weights, case.pose, case.goal, case.force, case.clearance, case.to_go)


@wp.kernel
def robot_cost_probe(weights: RobotWeights, cases: wp.array[Stage], out: wp.array[CostTerms]):
    n = wp.tid()
    out[n] = robot_cost(weights, cases[n])
