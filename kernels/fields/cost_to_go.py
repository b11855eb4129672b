"""Cost-to-go of the object: the length of the shortest free path to the goal over the grid of phi_2."""

import warp as wp

from oimppi_warp.kernels.geometry import PI, PoseField, pose_field, wrap_angle

wp.set_module_options({"enable_backward": False})


HOME = wp.constant(0.05)
"""Distance from the goal, yaw included, within which the path to it is straight [m]."""

NEAR_GOAL = wp.constant(0.015)
"""Distance from the goal, yaw included, within which the cost-to-go is the straight distance [m]."""

ON_PLAN = wp.constant(0.02)
"""Distance from a plan's poses, yaw included, within which a path counts as on the plan [m]."""

HEADWAY = wp.constant(0.7)
"""Decrease of the cost-to-go per metre of a step along the gradient, below which the gradient is not trusted. It is 1
where the field is smooth, and less at kinks and beside obstacles."""

DETOUR = wp.constant(0.4)
"""Cost per metre to a node when the best node around a pose is chosen. It is below the 0.5 per metre along a plan, so
that a node further along the plan is always preferred to the nearest."""


@wp.struct
class TravelCost:
    """Cost per metre of the object's path.

    Attributes:
        yaw_length: Length equivalent to a rotation by one radian [m].
        comfort: Clearance below which the cost increases [m].
        crowded: Additional cost at zero clearance.
        blocked: Cost inside an obstacle; finite, so that there is a path out from every pose.
        ring_inner, ring_outer: Distances from the base's axis between which the arm can push well [m].
        far: Cost outside these distances.
    """

    yaw_length: float
    comfort: float
    crowded: float
    blocked: float
    ring_inner: float
    ring_outer: float
    far: float


@wp.func
def cost_per_metre(travel: TravelCost, clearance: float, distance: float) -> float:
    """Returns the cost of a metre of path at a clearance [m] and a distance from the base's axis [m]."""
    lack = wp.clamp((travel.comfort - clearance) / travel.comfort, 0.0, 1.0)
    cost = 1.0 + travel.crowded * lack * lack
    if distance < travel.ring_inner or distance > travel.ring_outer:
        cost = wp.max(cost, travel.far)
    if clearance < 0.0:
        cost = travel.blocked
    return cost


@wp.kernel
def seed_to_go(
    # in:
    clearance: PoseField,
    travel: TravelCost,
    pose: wp.vec3,
    near: float,
    left: float,
    first: wp.vec3i,
    # out:
    to_go: wp.array3d[float],
):
    """Sets the cost-to-go around a pose to the straight distance to it plus ``left``, its own cost-to-go.

    Only nodes within ``near`` are set. Launched over a box of the grid's nodes (yaw, x, y) that starts at ``first``.
    """
    a, b, c = wp.tid()
    t = (first[0] + a + to_go.shape[0]) % to_go.shape[0]
    i = first[1] + b
    j = first[2] + c
    if i < 0 or i >= to_go.shape[1] or j < 0 or j >= to_go.shape[2]:
        return
    step = 1.0 / clearance.inv_step
    dx = clearance.origin[0] + step * float(i) - pose[0]
    dy = clearance.origin[1] + step * float(j) - pose[1]
    turn = travel.yaw_length * wrap_angle(2.0 * PI * float(t) / float(to_go.shape[0]) - pose[2])
    straight = wp.sqrt(dx * dx + dy * dy + turn * turn)
    if straight <= near:
        to_go[t, i, j] = wp.min(to_go[t, i, j], left + straight)


@wp.func
def sweep_order(n: int, m: int, backward: int) -> int:
    """Returns the m-th of n indices, counted forward or backward."""
    out = m
    if backward == 1:
        out = n - 1 - m
    return out


@wp.func
def mark_neighbours(stale: wp.array3d[wp.uint8], t: int, i: int, j: int):
    """Marks the 26 neighbours of a node."""
    nt = stale.shape[0]
    for dt in range(-1, 2):  # constant bounds: such loops are unrolled, which is faster
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                ii = i + dx
                jj = j + dy
                if ii >= 0 and ii < stale.shape[1] and jj >= 0 and jj < stale.shape[2]:
                    stale[(t + dt + nt) % nt, ii, jj] = wp.uint8(1)
    stale[t, i, j] = wp.uint8(0)


@wp.kernel
def sweep_to_go(
    # in:
    clearance: PoseField,
    travel: TravelCost,
    direction: int,
    # in and out:
    to_go: wp.array3d[float],
    stale: wp.array3d[wp.uint8],
    # out:
    change: wp.array[float],
):
    """Runs one Gauss-Seidel sweep of shortest paths over the 26 neighbours, in one of 8 directions (one thread).

    Sweeps in alternating directions propagate paths along the whole grid at once (fast sweeping, Zhao 2005), where
    parallel relaxation would take one pass per cell. ``stale`` marks the nodes of which a neighbour has improved since
    they were last computed; before the first sweep, all nodes are marked. Unmarked nodes cannot improve and are
    skipped (Bak, McLaughlin and Renzi 2010). ``change`` [1] is the largest improvement.
    """
    nt = to_go.shape[0]
    nx = to_go.shape[1]
    ny = to_go.shape[2]
    step = 1.0 / clearance.inv_step
    turn = travel.yaw_length / clearance.inv_yaw_step
    largest = float(0.0)
    for a in range(nt + 1):
        t = sweep_order(nt + 1, a, direction & 1) % nt
        for b in range(nx):
            i = sweep_order(nx, b, (direction >> 1) & 1)
            for c in range(ny):
                j = sweep_order(ny, c, (direction >> 2) & 1)
                if stale[t, i, j] == wp.uint8(0):
                    continue
                stale[t, i, j] = wp.uint8(0)
                old = to_go[t, i, j]
                at = clearance.origin + step * wp.vec2(float(i), float(j))
                here = cost_per_metre(travel, clearance.values[t, i, j], wp.length(at))
                best = old
                for dt in range(-1, 2):
                    tt = (t + dt + nt) % nt
                    for dx in range(-1, 2):
                        ii = i + dx
                        if ii >= 0 and ii < nx:
                            for dy in range(-1, 2):
                                jj = j + dy
                                if jj >= 0 and jj < ny:
                                    there = to_go[tt, ii, jj]
                                    if there < best:
                                        across = float(dx * dx + dy * dy) * step * step
                                        length = wp.sqrt(across + float(dt * dt) * turn * turn)
                                        best = wp.min(best, there + here * length)
                if best < old:
                    largest = wp.max(largest, old - best)
                    to_go[t, i, j] = best
                    mark_neighbours(stale, t, i, j)
    change[0] = largest


@wp.func
def turned_distance(a: wp.vec3, b: wp.vec3, yaw_length: float) -> float:
    """Returns the distance between two poses [m], a radian of yaw counted as ``yaw_length`` [m]."""
    d = b - a
    return wp.length(wp.vec3(d[0], d[1], yaw_length * wrap_angle(d[2])))


@wp.func
def distance_to_go(on_grid: float, pose: wp.vec3, goal: wp.vec3, yaw_length: float) -> float:
    """Returns the cost-to-go of a pose, given that of the grid there [m]; near the goal it is the straight distance.

    A field that is linear between nodes is lowest at a node, which is up to half a cell away from the goal. From
    ``NEAR_GOAL`` to twice that distance, the two are blended.
    """
    apart = wp.max(wp.abs(pose[0] - goal[0]), wp.abs(pose[1] - goal[1]))
    if apart > 2.0 * NEAR_GOAL:  # nearly always: saves the rest
        return on_grid
    straight = turned_distance(pose, goal, yaw_length)
    value = straight
    if straight > NEAR_GOAL:
        value = wp.lerp(straight, on_grid, wp.min(straight / NEAR_GOAL - 1.0, 1.0))
    return value


@wp.func
def downhill(to_go: PoseField, pose: wp.vec3, yaw_length: float, step: float) -> wp.vec3:
    """Returns the pose one step further down the cost-to-go.

    The step follows the gradient where this decreases the cost-to-go. Where it does not (at kinks of the field, and in
    passages as narrow as the grid, where the obstacles beside them spoil the values between nodes), it goes towards the
    surrounding node with the least remaining cost, including the distance to it. By construction, one of these nodes
    always makes progress.
    """
    field = pose_field(to_go, pose)
    scale = wp.vec3(1.0, 1.0, 1.0 / yaw_length)
    slope = wp.vec3(field[1], field[2], field[3] / yaw_length)
    size = wp.length(slope)
    if size > 1.0e-6:
        ahead = pose - (step / size) * wp.cw_mul(scale, slope)
        if pose_field(to_go, ahead)[0] < field[0] - HEADWAY * step:
            return ahead
    turns = to_go.values.shape[0]
    x = (pose[0] - to_go.origin[0]) * to_go.inv_step
    y = (pose[1] - to_go.origin[1]) * to_go.inv_step
    t = pose[2] * to_go.inv_yaw_step
    i0 = int(wp.floor(x)) - 1
    j0 = int(wp.floor(y)) - 1
    t0 = int(wp.floor(t)) - 1
    least = float(1.0e9)
    way = wp.vec3()
    for a in range(4):
        for b in range(4):
            for c in range(4):
                i = i0 + b
                j = j0 + c
                if i >= 0 and i < to_go.values.shape[1] and j >= 0 and j < to_go.values.shape[2]:
                    to = wp.vec3(
                        (float(i) - x) / to_go.inv_step,
                        (float(j) - y) / to_go.inv_step,
                        yaw_length * (float(t0 + a) - t) / to_go.inv_yaw_step,
                    )
                    value = to_go.values[((t0 + a) % turns + turns) % turns, i, j] + DETOUR * wp.length(to)
                    if value < least:
                        least = value
                        way = to
    return pose + wp.min(1.0, step / wp.max(wp.length(way), 1.0e-6)) * wp.cw_mul(scale, way)


@wp.kernel
def descend(
    # in:
    to_go: PoseField,
    plan: wp.array[wp.vec3],
    start: wp.array[wp.vec3],
    goal: wp.array[wp.vec3],
    yaw_length: float,
    step: float,
    # out:
    way: wp.array2d[wp.vec3],
):
    """Computes the path from a pose to the goal, at constant speed: onto a plan and along it.

    Off the plan it descends the cost-to-go. On the plan, which is within ``ON_PLAN`` of one of its poses, it continues
    from the last of those. Within ``HOME`` of the goal, the path is straight. Launched with one block (on the CPU: one
    thread), which divides the poses of the plan among its threads; all of them follow the path. Shapes: ``plan`` [m] or
    empty, ``start`` and ``goal`` [1], ``way`` [1, n].
    """
    i = wp.tid()
    pose = start[0]
    if i == 0:
        way[0, 0] = pose
    for h in range(1, way.shape[1]):
        target = goal[0]
        straight = bool(turned_distance(pose, target, yaw_length) < HOME)
        last = int(-1)
        if not straight:
            for k in range(i, plan.shape[0], wp.block_dim()):
                m = plan.shape[0] - 1 - k
                if turned_distance(pose, plan[m], yaw_length) < ON_PLAN:
                    last = m
                    break
        last = wp.tile_max(wp.tile(last))[0]
        if last >= 0:
            target = plan[wp.min(last + 1, plan.shape[0] - 1)]
            straight = True
        if straight:
            left = target - pose
            left[2] = wrap_angle(left[2])
            pose = pose + wp.min(1.0, step / wp.max(turned_distance(pose, target, yaw_length), 1.0e-6)) * left
        else:
            pose = downhill(to_go, pose, yaw_length, step)
        if i == 0:
            way[0, h] = pose
