"""Rollouts of the object level: the object moved by a virtual wrench."""

import warp as wp

from oimppi_warp.kernels.costs.stage_costs import ObjectWeights, object_cost
from oimppi_warp.kernels.fields.cost_to_go import HOME, distance_to_go, turned_distance
from oimppi_warp.kernels.geometry import PoseField, field_in_cell, pose_cell, wrap_angle
from oimppi_warp.kernels.options import fast
from oimppi_warp.kernels.pushing import ObjectModel, mobility, settle

wp.set_module_options(fast())


@wp.kernel
def object_rollout(
    # in:
    first: int,
    model: ObjectModel,
    weights: ObjectWeights,
    to_go: PoseField,
    yaw_length: float,
    start: wp.array[wp.vec3],
    goal: wp.array[wp.vec3],
    wrenches: wp.array2d[wp.vec3],
    dt: float,
    # out:
    costs: wp.array[float],
    poses: wp.array2d[wp.vec3],
):
    """Computes the cost of each wrench sequence, and its poses unless ``poses`` is empty.

    The object moves by ``x_o <- x_o + dt D w_o`` (equation 6, which is equation 2 with ``f_o = x_o`` and
    ``h_o = dt D``), then out of obstacles by :func:`settle`. The cost is ``S_o = sum_h l_o``, equation 10 for the
    objective of equation 13; there is no terminal cost l_f.

    A GPU waits for memory most of the time: wrenches are read a step early, and the cost-to-go together with phi_2.

    Lengths: ``yaw_length`` [m] is what a radian of yaw counts as in the cost-to-go ``to_go``, whose grid is that of
    phi_2; it is read even if it has no weight.
    Shapes: ``start`` [1], ``goal`` [1], ``wrenches`` [sample, horizon] (N, N, N m), ``costs`` [sample],
    ``poses`` [sample, horizon + 1] or empty.
    """
    k = first + wp.tid()
    travel = mobility(model) * (dt / model.force)  # D dt
    pose = start[0]
    target = goal[0]
    keep = k < poses.shape[0]
    if keep:
        poses[k, 0] = pose
    cost = float(0.0)
    wrench = wrenches[k, 0]
    for h in range(wrenches.shape[1]):
        free = pose + wp.cw_mul(travel, wrench)
        wrench = wrenches[k, wp.min(h + 1, wrenches.shape[1] - 1)]
        on_grid = field_in_cell(to_go, pose_cell(to_go, free))[0]
        settled = settle(model, free, dt)
        if settled.force > 0.0:
            on_grid = field_in_cell(to_go, settled.cell)[0]
        pose = settled.pose
        way = distance_to_go(on_grid, pose, target, yaw_length)
        cost += object_cost(weights, pose, target, settled.force, settled.clearance, way)
        if keep:
            poses[k, h + 1] = pose
    costs[k] = cost


@wp.kernel
def follow_path(
    # in:
    path: wp.array2d[wp.vec3],
    pace: wp.array[float],
    # out:
    reference: wp.array[wp.vec3],
):
    """Copies a path to the reference and holds its end (Algorithm 2, line 4).

    ``pace`` is the number of the path's steps that the reference makes per control step; 1 in the paper.
    Shapes: ``path`` [1, horizon + 1], ``pace`` [1], ``reference`` [n].
    """
    i = wp.tid()
    at = pace[0] * float(i)
    before = wp.min(int(at), path.shape[1] - 1)
    pose = path[0, before]
    way = path[0, wp.min(before + 1, path.shape[1] - 1)] - pose
    way[2] = wrap_angle(way[2])
    reference[i] = pose + (at - wp.floor(at)) * way


@wp.kernel
def end_at_goal(
    # in:
    goal: wp.array[wp.vec3],
    yaw_length: float,
    step: float,
    # out:
    path: wp.array2d[wp.vec3],
):
    """Replaces a path that begins within ``HOME`` of the goal by the straight one to the goal, at constant speed.

    Sampled wrenches end near the goal, never at it. Shapes: ``goal`` [1], ``path`` [1, n]; ``step`` is the length of a
    step, and ``yaw_length`` what a radian counts as [m]. Launched with one thread.
    """
    start = path[0, 0]
    left = turned_distance(start, goal[0], yaw_length)
    if left < HOME:
        way = goal[0] - start
        way[2] = wrap_angle(way[2])
        for i in range(1, path.shape[1]):
            path[0, i] = start + wp.min(1.0, float(i) * step / wp.max(left, 1.0e-6)) * way
