"""Kernels that compute distance fields: phi_2 over planar poses, and the distance to the obstacles over space."""

import warp as wp

from oimppi_warp.kernels.geometry import PI, rotate

wp.set_module_options({"enable_backward": False})


@wp.struct
class Pieces:
    """Convex pieces: cores as vertex lists, counter-clockwise, each grown by a radius.

    Attributes:
        vertices: All vertices [m].
        first: Index of each piece's first vertex; one more entry closes the last piece.
        center: A point inside each piece [m].
        reach: Largest distance of the piece from its center, radius included [m].
        radius: Radius that each core is grown by [m].
    """

    vertices: wp.array[wp.vec2]
    first: wp.array[int]
    center: wp.array[wp.vec2]
    reach: wp.array[float]
    radius: wp.array[float]


@wp.func
def segment_distance(p: wp.vec2, a: wp.vec2, b: wp.vec2) -> float:
    """Returns the distance of a point to a segment [m]."""
    ab = b - a
    t = wp.clamp(wp.dot(p - a, ab) / wp.max(wp.dot(ab, ab), 1.0e-12), 0.0, 1.0)
    return wp.length(p - (a + t * ab))


@wp.func
def widest_gap(edges: Pieces, i: int, pose_e: wp.vec3, points: Pieces, j: int, pose_p: wp.vec3) -> float:
    """Returns the largest signed distance of piece j of ``points`` from an edge of piece i of ``edges``, cores only."""
    ce = wp.cos(pose_e[2])
    se = wp.sin(pose_e[2])
    cp = wp.cos(pose_p[2])
    sp = wp.sin(pose_p[2])
    best = float(-1.0e6)
    n = edges.first[i + 1] - edges.first[i]
    if n >= 2:
        for e in range(n):
            a = rotate(ce, se, edges.vertices[edges.first[i] + e])
            b = rotate(ce, se, edges.vertices[edges.first[i] + (e + 1) % n])
            normal = wp.normalize(wp.vec2(b[1] - a[1], a[0] - b[0]))
            offset = wp.dot(normal, a + wp.vec2(pose_e[0], pose_e[1]))
            gap = float(1.0e6)
            for v in range(points.first[j], points.first[j + 1]):
                q = rotate(cp, sp, points.vertices[v]) + wp.vec2(pose_p[0], pose_p[1])
                gap = wp.min(gap, wp.dot(normal, q) - offset)
            best = wp.max(best, gap)
    return best


@wp.func
def nearest_vertex(edges: Pieces, i: int, pose_e: wp.vec3, points: Pieces, j: int, pose_p: wp.vec3) -> float:
    """Returns the least distance of a vertex of piece j of ``points`` to an edge of piece i of ``edges`` [m].

    The radii are not counted.
    """
    ce = wp.cos(pose_e[2])
    se = wp.sin(pose_e[2])
    cp = wp.cos(pose_p[2])
    sp = wp.sin(pose_p[2])
    best = float(1.0e6)
    n = edges.first[i + 1] - edges.first[i]
    for e in range(n):
        a = rotate(ce, se, edges.vertices[edges.first[i] + e]) + wp.vec2(pose_e[0], pose_e[1])
        b = rotate(ce, se, edges.vertices[edges.first[i] + (e + 1) % n]) + wp.vec2(pose_e[0], pose_e[1])
        for v in range(points.first[j], points.first[j + 1]):
            q = rotate(cp, sp, points.vertices[v]) + wp.vec2(pose_p[0], pose_p[1])
            best = wp.min(best, segment_distance(q, a, b))
    return best


@wp.func
def piece_distance(a: Pieces, i: int, pose_a: wp.vec3, b: Pieces, j: int, pose_b: wp.vec3) -> float:
    """Returns the signed distance of two convex pieces [m]; negative, it is the smallest depth of penetration."""
    gap = wp.max(widest_gap(a, i, pose_a, b, j, pose_b), widest_gap(b, j, pose_b, a, i, pose_a))
    if gap > 0.0 or gap < -1.0e5:
        # Apart: the separating edge only bounds the distance, which lies between a vertex and an edge.
        gap = wp.min(nearest_vertex(a, i, pose_a, b, j, pose_b), nearest_vertex(b, j, pose_b, a, i, pose_a))
    return gap - a.radius[i] - b.radius[j]


@wp.func
def obstacle_clearance(body: Pieces, obstacles: Pieces, pose: wp.vec3, furthest: float) -> float:
    """Returns the body's clearance to obstacles at a pose, at most ``furthest`` [m]."""
    rest = wp.vec3(0.0, 0.0, 0.0)
    c = wp.cos(pose[2])
    s = wp.sin(pose[2])
    clearance = furthest
    for a in range(body.radius.shape[0]):
        center = rotate(c, s, body.center[a]) + wp.vec2(pose[0], pose[1])
        for b in range(obstacles.radius.shape[0]):
            if wp.length(center - obstacles.center[b]) - body.reach[a] - obstacles.reach[b] < clearance:
                clearance = wp.min(clearance, piece_distance(body, a, pose, obstacles, b, rest))
    return clearance


@wp.func
def edge_clearance(body: Pieces, table_lower: wp.vec2, table_upper: wp.vec2, pose: wp.vec3, furthest: float) -> float:
    """Returns the body's clearance to the table's edge at a pose, at most ``furthest`` [m]; negative beyond it."""
    c = wp.cos(pose[2])
    s = wp.sin(pose[2])
    clearance = furthest
    for a in range(body.radius.shape[0]):
        for v in range(body.first[a], body.first[a + 1]):
            q = rotate(c, s, body.vertices[v]) + wp.vec2(pose[0], pose[1])
            edge = wp.min(wp.min(q[0] - table_lower[0], table_upper[0] - q[0]),
                          wp.min(q[1] - table_lower[1], table_upper[1] - q[1]))  # fmt: skip
            clearance = wp.min(clearance, edge - body.radius[a])
    return clearance


@wp.func
def node_at(n: int, columns: int, layers: int) -> wp.vec3i:
    """Returns the indices of the n-th node of a grid with these numbers of columns and layers (the last two axes)."""
    row = n / layers
    return wp.vec3i(row / columns, row % columns, n % layers)


@wp.func
def node_pose(origin: wp.vec3, step: float, node: wp.vec3i, turns: int) -> wp.vec3:
    """Returns the pose of a node of a pose field with ``turns`` nodes of yaw, the first of them at ``origin``."""
    yaw = origin[2] + 2.0 * PI * float(node[0]) / float(turns)
    return wp.vec3(origin[0] + step * float(node[1]), origin[1] + step * float(node[2]), yaw)


@wp.kernel
def object_obstruction(
    # in:
    first: int,
    body: Pieces,
    obstacles: Pieces,
    origin: wp.vec3,
    step: float,
    furthest: float,
    # in and out:
    values: wp.array3d[float],
):
    """Computes the object's clearance to obstacles, the table's edge aside, at the nodes of a pose field [m].

    Nodes at which ``values`` holds an estimate of ``furthest`` or more, positive or negative, keep it.
    """
    at = node_at(first + wp.tid(), values.shape[1], values.shape[2])
    if wp.abs(values[at[0], at[1], at[2]]) < furthest:
        pose = node_pose(origin, step, at, values.shape[0])
        values[at[0], at[1], at[2]] = obstacle_clearance(body, obstacles, pose, furthest)


@wp.kernel
def object_clearance(
    # in:
    first: int,
    body: Pieces,
    obstruction: wp.array3d[float],
    table_lower: wp.vec2,
    table_upper: wp.vec2,
    origin: wp.vec3,
    step: float,
    # out:
    values: wp.array3d[float],
):
    """Computes ``phi_2(x_o)``, the gap of object and environment in equation 4, at the nodes of a pose field [m].

    It is the smaller of two gaps: that to obstacles (``obstruction``, by :func:`object_obstruction`), and that to the
    table's edge.
    """
    at = node_at(first + wp.tid(), values.shape[1], values.shape[2])
    pose = node_pose(origin, step, at, values.shape[0])
    known = obstruction[at[0], at[1], at[2]]
    values[at[0], at[1], at[2]] = edge_clearance(body, table_lower, table_upper, pose, known)


@wp.kernel
def pose_clearance(
    # in:
    body: Pieces,
    obstacles: Pieces,
    table_lower: wp.vec2,
    table_upper: wp.vec2,
    poses: wp.array[wp.vec3],
    furthest: float,
    # out:
    values: wp.array[float],
):
    """Computes phi_2 at poses. Shapes: ``poses`` and ``values`` [pose]."""
    n = wp.tid()
    edge = edge_clearance(body, table_lower, table_upper, poses[n], furthest)
    values[n] = obstacle_clearance(body, obstacles, poses[n], edge)


@wp.kernel
def space_distance(
    # in:
    first: int,
    mesh: wp.uint64,
    origin: wp.vec3,
    step: float,
    furthest: float,
    # out:
    values: wp.array3d[float],
):
    """Computes the signed distance to a closed mesh at the nodes of a space field, cut off at ``furthest`` [m]."""
    at = node_at(first + wp.tid(), values.shape[1], values.shape[2])
    p = origin + step * wp.vec3(float(at[0]), float(at[1]), float(at[2]))
    hit = wp.mesh_query_point_sign_winding_number(mesh, p, furthest)
    distance = furthest
    if hit.result:
        nearest = wp.mesh_eval_position(mesh, hit.face, hit.u, hit.v)
        distance = wp.min(hit.sign * wp.length(p - nearest), furthest)
    values[at[0], at[1], at[2]] = distance
