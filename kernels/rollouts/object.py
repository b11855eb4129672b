"""Rollouts of the object level: the object moved by a virtual wrench."""

import warp as wp

from oimppi_warp.kernels.costs.stage_costs import ObjectWeights, object_cost
from oimppi_warp.kernels.geometry import PoseField, pose_field
from oimppi_warp.kernels.pushing import ObjectModel, mobility, settle

wp.set_module_options({"enable_backward": False})


@wp.kernel
def object_rollout(
    # in:
    first: int,
    model: ObjectModel,
    weights: ObjectWeights,
    to_go: PoseField,
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

    Shapes: ``start`` [1], ``goal`` [1], ``wrenches`` [sample, horizon] (N, N, N m), ``costs`` [sample],
    ``poses`` [sample, horizon + 1] or empty.
    """
    k = first + wp.tid()
    travel = mobility(model) * (dt / model.force)  # D dt
    pose = start[0]
    keep = k < poses.shape[0]
    if keep:
        poses[k, 0] = pose
    cost = float(0.0)
    for h in range(wrenches.shape[1]):
        settled = settle(model, pose + wp.cw_mul(travel, wrenches[k, h]), dt)
        pose = settled.pose
        way = float(0.0)
        if weights.w_to_go > 0.0:
            way = pose_field(to_go, pose)[0]
        cost += object_cost(weights, pose, goal[0], settled.force, settled.clearance, way)
        if keep:
            poses[k, h + 1] = pose
    costs[k] = cost


@wp.kernel
def follow_path(path: wp.array2d[wp.vec3], reference: wp.array[wp.vec3]):
    """Copies a path, shape [1, horizon + 1], to the reference, shape [n], and holds its end (Algorithm 2, line 4)."""
    i = wp.tid()
    reference[i] = path[0, wp.min(i, path.shape[1] - 1)]
