"""NumPy float64 twins of the Warp kernels, written from the equations and not from the kernels.

Each function bears the name of its kernel or ``wp.func``. Lengths are metres, angles radians, forces newtons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import shapely
from scipy.spatial.transform import Rotation

from oimppi_warp.config.settings import ObjectCost, RobotCost
from oimppi_warp.geometry.footprint import Piece
from oimppi_warp.geometry.kinematics import collider_spheres
from oimppi_warp.kernels.contact import PENETRATION_TOLERANCE
from oimppi_warp.kernels.costs.stage_costs import TERMS
from oimppi_warp.kernels.fields.stance import StanceField
from oimppi_warp.kernels.geometry import PlanarField, PoseField, SpaceField
from oimppi_warp.kernels.pushing import ObjectModel
from oimppi_warp.kernels.upright import UprightArm
from oimppi_warp.scene import Link, Robot

LENGTH_TOLERANCE = 2e-5
"""Kernel and twin agree on lengths to this [m] (float32 over coordinates of about a metre)."""
ANGLE_TOLERANCE = 1e-4
"""... and on angles to this [rad]."""
RELATIVE_TOLERANCE = 2e-4
"""... and on costs, forces and gradients to this, relatively."""
WEIGHT_TOLERANCE = 1e-6
"""... and on weights that sum to one to this."""
NEAR_GOAL = 0.015
JAM = 2e-3
"""Depth of a jam between tool and object from which the arm stalls [m]."""
INTERPOLATION_ERROR = 0.006
"""phi_2 between its nodes is off by this at the very most (a kink in the middle of a cell) [m]."""


def wrap_angle(angle: float | np.ndarray) -> float | np.ndarray:
    return np.arctan2(np.sin(angle), np.cos(angle))


def planar_rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


# Fields


@dataclass(frozen=True, eq=False)
class Grid:
    """A field on the host: value and gradient anywhere by :meth:`at`.

    Attributes:
        values: One axis for each coordinate, in the coordinates' order.
        origin: Coordinates of the first node.
        step: Spacing of the nodes along each axis.
        periodic: Index of an axis that wraps around, or -1.
    """

    values: np.ndarray
    origin: np.ndarray
    step: np.ndarray
    periodic: int = -1

    def at(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        """Multilinear value and its gradient; clamped to the box along axes that are not periodic."""
        index = (np.asarray(point, dtype=float) - self.origin) / self.step
        count = np.array(self.values.shape)
        clamped = np.clip(index, 0.0, count - 1.0 - 1e-3)
        if self.periodic >= 0:
            clamped[self.periodic] = index[self.periodic] % count[self.periodic]
        index = clamped
        low = index.astype(int)
        cell = self.values[np.ix_(*([i % n, (i + 1) % n] for i, n in zip(low, count, strict=True)))]
        shares = np.stack([1.0 - (index - low), index - low], axis=1)
        slopes = np.array([-1.0, 1.0])

        def contracted(along: int) -> float:
            out = cell
            for axis, share in enumerate(shares):
                out = np.tensordot(slopes if axis == along else share, out, axes=(0, 0))
            return float(out)

        return contracted(-1), np.array([contracted(axis) for axis in range(len(low))]) / self.step


def planar_grid(source: PlanarField) -> Grid:
    """The field over (x, y)."""
    return Grid(source.values.numpy().astype(float), np.array(source.origin), np.full(2, 1.0 / source.inv_step))


def pose_grid(source: PoseField) -> Grid:
    """The field over (x, y, yaw)."""
    values = np.moveaxis(source.values.numpy().astype(float), 0, 2)
    step = np.array([1.0 / source.inv_step, 1.0 / source.inv_step, 2.0 * np.pi / values.shape[2]])
    return Grid(values, np.array([*source.origin, 0.0]), step, periodic=2)


def space_field(source: SpaceField, point: np.ndarray) -> float:
    """The field's value, ``outside`` beyond its box; below the box it is that at the bottom."""
    return _space_field(source, point)[0]


def space_gradient(source: SpaceField, point: np.ndarray) -> np.ndarray:
    """The field's gradient [3], zero beyond its box."""
    return _space_field(source, point)[1]


def _space_field(source: SpaceField, point: np.ndarray) -> tuple[float, np.ndarray]:
    values = source.values.numpy().astype(float)
    grid = Grid(values, np.array(source.origin), np.full(3, 1.0 / source.inv_step))
    index = (point - grid.origin) / grid.step
    index[2] = max(index[2], 0.0)
    if (index < 0.0).any() or (index >= np.array(values.shape) - 1.0).any():
        return source.outside, np.zeros(3)
    return grid.at(grid.origin + index * grid.step)


def piece_distance(a: Piece, b: Piece) -> float:
    """Distance of two pieces that lie apart [m]."""
    cores = [shapely.MultiPoint(piece.vertices).convex_hull for piece in (a, b)]
    return shapely.distance(*cores) - a.radius - b.radius


def to_go(
    clearance: np.ndarray,
    way: np.ndarray,
    *,
    step: float,
    yaw_length: float,
    near: float,
    cost_per_metre: Callable[[float, float], float],
) -> np.ndarray:
    """Shortest way to a way [n, 3] and along it to its end, by Dijkstra over 26 neighbours.

    The grid ``clearance`` [yaw, x, y] has its first node at the base's axis; ``cost_per_metre`` is of clearance and
    distance to that axis. Within ``near`` of the way straight distances hold, and a metre along it costs half.
    """
    shape, turn = clearance.shape, 2.0 * np.pi / clearance.shape[0]
    index = np.arange(clearance.size).reshape(shape)
    source = clearance.size
    lengths = np.linalg.norm(_apart(way[1:], way[:-1], yaw_length), axis=1)
    left = [0.5 * lengths[i:].sum() for i in range(len(way))]
    edges: list[tuple[Any, Any, Any]] = []
    for t, i, j in np.ndindex(*shape):
        straight = np.linalg.norm(_apart(np.array([step * i, step * j, turn * t]), way, yaw_length), axis=1)
        if straight.min() <= near:
            edges.append((source, index[t, i, j], (straight + left)[straight <= near].min()))
        for dt, di, dj in np.ndindex(3, 3, 3):
            tt, ii, jj = (t + dt - 1) % shape[0], i + di - 1, j + dj - 1
            if 0 <= ii < shape[1] and 0 <= jj < shape[2] and (tt, ii, jj) != (t, i, j):
                length = np.linalg.norm([step * (di - 1), step * (dj - 1), yaw_length * turn * (dt - 1)])
                edges.append(
                    (
                        index[tt, ii, jj],
                        index[t, i, j],
                        length * cost_per_metre(float(clearance[t, i, j]), step * np.hypot(i, j)),
                    )
                )
    rows, columns, weights = (np.array(part) for part in zip(*edges, strict=True))
    graph = scipy.sparse.coo_array((weights, (rows, columns)), shape=(source + 1, source + 1)).tocsr()
    return scipy.sparse.csgraph.dijkstra(graph, indices=source)[:source].reshape(shape)


def _apart(a: np.ndarray, b: np.ndarray, yaw_length: float) -> np.ndarray:
    """What separates poses: (x, y, length of the turn) [m]."""
    between = a - b
    between[..., 2] = yaw_length * wrap_angle(between[..., 2])
    return between


# The arm


def link_frames(robot: Robot, joints: np.ndarray) -> list[np.ndarray]:
    """Homogeneous transforms of all links in the world frame."""
    frames, frame = [], np.eye(4)
    for joint, moved in zip(robot.joints, joints, strict=True):
        slid, angle = (moved, 0.0) if joint.kind == "prismatic" else (0.0, moved)
        frame = frame @ homogeneous(joint.parent_transform) @ homogeneous([0, 0, slid, 0, 0, *half_turn(angle)])
        frames.append(frame)
    return frames


def half_turn(angle: float) -> tuple[float, float]:
    """The last two entries (z, w) of the quaternion that turns by ``angle`` about z."""
    return np.sin(angle / 2), np.cos(angle / 2)


def homogeneous(transform: np.ndarray | list[float]) -> np.ndarray:
    """The 4 x 4 matrix of a transform (position, quaternion xyzw)."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(transform[3:]).as_matrix()
    out[:3, 3] = transform[:3]
    return out


def tip_frame(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Homogeneous transform of the tool's tip."""
    return link_frames(robot, joints)[-1] @ homogeneous(robot.tip)


def arm_spheres(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """The spheres that stand for the arm, in the world frame, shape [n, 4]."""
    spheres = [np.zeros((0, 4))]
    for link, frame in zip(robot.links, link_frames(robot, joints), strict=True):
        for collider in link.colliders:
            local = collider_spheres(collider)
            spheres.append(np.column_stack([local[:, :3] @ frame[:3, :3].T + frame[:3, 3], local[:, 3]]))
    return np.concatenate(spheres)


# Costs


def pose_distance_squared(a: np.ndarray, b: np.ndarray, w_theta: float) -> float:
    """Equation 16, with the angle from the trace of the rotation as printed."""
    between = Rotation.from_euler("z", a[2]).inv() * Rotation.from_euler("z", b[2])
    angle = np.arccos(np.clip((np.trace(between.as_matrix()) - 1.0) / 2.0, -1.0, 1.0))
    return float(np.sum((a[:2] - b[:2]) ** 2) + w_theta * angle**2)


def outside_ring(pose: np.ndarray, ring: tuple[float, float], goal: np.ndarray) -> float:
    """Distance of the object's centre to the ring in which the arm pushes, widened to the goal [m]."""
    distance, there = float(np.hypot(*pose[:2])), float(np.hypot(*goal[:2]))
    return max(min(ring[0], there) - distance, 0.0) + max(distance - max(ring[1], there), 0.0)


def over_edge(pose: np.ndarray, edge: tuple[np.ndarray, np.ndarray]) -> float:
    """How far a centre lies outside of the rectangle ``edge``, summed over its axes [m]."""
    return float(np.maximum(edge[0] - pose[:2], 0.0).sum() + np.maximum(pose[:2] - edge[1], 0.0).sum())


def object_cost(w: ObjectCost, pose: np.ndarray, goal: np.ndarray, force: float, clearance: float, way: float) -> float:
    """Equation 15 and the terms of our own."""
    return (
        w.w_d * pose_distance_squared(pose, goal, w.w_theta)
        + w.w_f * max(force - w.f_0, 0.0) ** 2
        + w.w_margin * max(w.margin - clearance, 0.0) ** 2
        + w.w_to_go * way
        + w.w_push_ring * outside_ring(pose, w.push_ring, goal)
    )


def align_cost(tip: np.ndarray, center: np.ndarray, target: np.ndarray, gamma_0: float, fade: float) -> float:
    """Equation 18, faded out close to the target."""
    push, way = center - tip, target - center
    cosine = push @ way / max(np.linalg.norm(push) * np.linalg.norm(way), 1e-6)
    share = min(np.linalg.norm(way) / fade, 1.0) if fade > 0.0 else 1.0
    return float(share * max(gamma_0 - cosine, 0.0))


def tilt_cost(rotation: np.ndarray) -> float:
    """Equation 19 for the rotation of a tip whose z axis points out of the tool (down, when upright)."""
    r = rotation @ Rotation.from_euler("x", np.pi).as_matrix()
    return float(np.hypot(np.arctan2(r[2, 1], r[2, 2]), np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2]))))


def topple_cost(w: RobotCost, tip: np.ndarray, rotation: np.ndarray, velocity: np.ndarray, center: np.ndarray,
                top: float, speed: float, size: float) -> float:  # fmt: skip
    """A stick that leans over an object close by, and comes at it faster than ``speed``."""
    distance = max(float(np.linalg.norm(center - tip[:2])), 1e-6)
    way = (center - tip[:2]) / distance
    share = min(1.0 - (distance - size) / w.topple_near, 1.0)
    if share <= 0.0 or tip[2] >= top:
        return 0.0
    stick = -rotation[:, 2]
    overhang = max(float(stick[:2] @ way), 0.0) / max(stick[2], 0.1) * (top - tip[2])
    return share * (w.w_overhang * overhang**2 + w.w_rush * max(float(velocity @ way) - speed, 0.0) ** 2)


def distance_to_go(field: Grid, pose: np.ndarray, goal: np.ndarray, yaw_length: float) -> float:
    """The cost-to-go, and the straight distance close to the goal [m]."""
    straight = float(np.linalg.norm(_apart(pose, goal, yaw_length)))
    share = np.clip(straight / NEAR_GOAL - 1.0, 0.0, 1.0)
    return float((1.0 - share) * straight + (share * field.at(pose)[0] if share > 0.0 else 0.0))


def stance(field: StanceField, tip: np.ndarray, pose: np.ndarray, target: np.ndarray) -> float:
    """Remaining way of the tool to a place from which it pushes the object to the target, read from the field [m]."""
    into_object = planar_rotation(pose[2]).T
    x, y = into_object @ (tip[:2] - pose[:2])
    vx, vy = into_object @ (target[:2] - pose[:2])
    spin = field.yaw_length * wrap_angle(target[2] - pose[2])
    azimuth = np.arctan2(vy, vx) / (2.0 * np.pi) % 1.0 * field.azimuths
    elevation = (np.arctan2(spin, np.hypot(vx, vy)) / np.pi + 0.5) * (field.elevations - 1)
    values = field.values.numpy().astype(float).reshape(field.elevations, field.azimuths, *field.values.shape[1:])
    a, e = int(azimuth) % field.azimuths, min(int(elevation), field.elevations - 2)
    total, steps = 0.0, 1.0 / field.inv_step
    for da, wa in ((0, 1.0 - azimuth % 1.0), (1, azimuth % 1.0)):
        for de, we in ((0, 1.0 - (elevation - e)), (1, elevation - e)):
            layer = values[e + de, (a + da) % field.azimuths]
            grid = Grid(layer, np.array(field.origin), np.full(2, steps))
            total += wa * we * grid.at(np.array([x, y]))[0]
    last = np.array(field.origin) + steps * (np.array(values.shape[2:]) - 1)
    inside = np.clip([x, y], np.array(field.origin), last)
    return float(total + np.hypot(*(np.array([x, y]) - inside)))


NO_WAYPOINT = np.zeros(4)
"""No waypoint: its weight is zero."""


def robot_cost(
    w: RobotCost,
    *,
    tip: np.ndarray,
    rotation: np.ndarray,
    velocity: np.ndarray,
    pose: np.ndarray,
    top: float,
    goal: np.ndarray,
    reference: np.ndarray,
    target: np.ndarray,
    to_go: float = 0.0,
    stance: float = 0.0,
    force: float,
    arm_clearance: float,
    above: float,
    pressed: float,
    gap: float,
    rise: float,
    speed_squared: float,
    collision: float = 0.0,
    waypoint: np.ndarray = NO_WAYPOINT,
    edge: tuple[np.ndarray, np.ndarray] = (np.full(2, -np.inf), np.full(2, np.inf)),
    topple_speed: float = 0.0,
    size: float = 0.0,
) -> dict[str, float]:
    """Equations 15 to 19 and the terms of our own, weighted, by the names in ``kernels.cost.TERMS``."""
    center = np.array([pose[0], pose[1], 0.5 * top])
    return {
        "goal": w.w_d * pose_distance_squared(pose, goal, w.w_theta) + w.w_to_go * to_go,
        "contact": w.w_f * max(force - w.f_0, 0.0) ** 2 + w.w_margin * max(w.margin - gap, 0.0) ** 2,
        "reference": w.w_reference * pose_distance_squared(pose, reference, w.w_theta),
        "approach": 0.0 if waypoint[3] > 0.0 else w.w_ee * max(np.sum((tip - center) ** 2) - w.r_0**2, 0.0),
        "align": 0.0
        if waypoint[3] > 0.0
        else w.w_align * align_cost(tip[:2], pose[:2], target[:2], w.gamma_0, w.align_fade),
        "tilt": w.w_tilt * tilt_cost(rotation),
        "track": w.w_track * pose_distance_squared(pose, reference, w.w_theta) ** 0.5,
        "stance": 0.0
        if waypoint[3] > 0.0
        else w.w_stance * min(pose_distance_squared(pose, target, w.w_theta) ** 0.5 / w.stance_fade, 1.0) * stance,
        "height": 0.0 if waypoint[3] > 0.0 else w.w_height * (tip[2] - w.height) ** 2,
        "arm_clearance": w.w_arm_clearance * max(w.arm_clearance - arm_clearance, 0.0) ** 2,
        "above": w.w_above * above,
        "push_ring": w.w_push_ring * outside_ring(pose, w.push_ring, goal) + w.w_edge * over_edge(pose, edge),
        "press": w.w_press * pressed**2 + w.w_lift * rise**2,
        "control": w.w_control * speed_squared,
        "collision": w.w_collision * max(collision - w.f_0, 0.0),
        "topple": topple_cost(w, tip, rotation, velocity, pose[:2], top, topple_speed, size),
        "waypoint": max(waypoint[3], 0.0) * np.sum((tip - waypoint[:3]) ** 2),
    }


# Pushing


@dataclass(frozen=True, eq=False)
class Body:
    """The pushed object on the host, as :class:`oimppi_warp.kernels.pushing.ObjectModel` has it."""

    force: float
    radius: float
    tool_friction: float
    top: float
    clearance: Grid
    outline: Grid
    slack: float

    @classmethod
    def of(cls, model: ObjectModel) -> Body:
        """The same numbers as the kernels read."""
        return cls(
            model.force,
            model.radius,
            model.tool_friction,
            model.top,
            pose_grid(model.clearance),
            planar_grid(model.body),
            model.slack,
        )

    @property
    def mobility(self) -> np.ndarray:
        """The limit surface's D without its factor 1 / (mu m g)."""
        return np.diag([1.0, 1.0, 1.0 / self.radius**2])

    def gap(self, pose: np.ndarray, point: np.ndarray) -> float:
        """Distance of a point in the world to the outline (phi_1 of a point robot)."""
        return self.outline.at(planar_rotation(pose[2]).T @ (point - pose[:2]))[0]


def push(body: Body, pose: np.ndarray, start: np.ndarray, end: np.ndarray, tool_radius: float) -> np.ndarray:
    """Example 1 with friction: the twist that makes way for the tool, by a force within the friction cone."""
    turn = planar_rotation(pose[2])
    local = turn.T @ (end - pose[:2])
    gap, gradient = body.outline.at(local)
    depth = tool_radius - gap
    if depth <= 0.0 or not gradient.any():  # no contact, or too deep inside to know a way out
        return pose
    normal = -gradient / np.linalg.norm(gradient)
    tangent = np.array([-normal[1], normal[0]])
    contact = local + gap * normal
    travel = turn.T @ (end - start)
    in_contact = np.clip(depth / max(travel @ normal, 1e-6), 0.0, 1.0)
    wanted = depth * normal + in_contact * (travel @ tangent) * tangent

    point = np.array([[1.0, 0.0, -contact[1]], [0.0, 1.0, contact[0]]])  # twist -> velocity of the contact point
    yields = point @ body.mobility @ point.T
    force = np.linalg.solve(yields, wanted)
    if abs(force @ tangent) > body.tool_friction * (force @ normal):
        edge = normal + np.sign(force @ tangent) * body.tool_friction * tangent
        if normal @ yields @ edge < 0.05:
            edge = normal
        force = depth / (normal @ yields @ edge) * edge
    twist = body.mobility @ point.T @ force
    return pose + np.array([*(turn @ twist[:2]), twist[2]])


def settle(body: Body, pose: np.ndarray, dt: float) -> tuple[np.ndarray, float, float]:
    """Equation 4 by projection along D grad phi_2: the pose, lambda_2 and phi_2 before."""
    clearance, gradient = body.clearance.at(pose)
    before, force = clearance, 0.0
    for _ in range(2):
        if clearance < body.slack:
            step = min(body.slack - clearance, 0.02) / max(float(gradient @ body.mobility @ gradient), 0.1)
            pose = pose + step * body.mobility @ gradient
            force += body.force * step / dt
            clearance, gradient = body.clearance.at(pose)
    return pose, force, before


def object_rollout(
    body: Body, w: ObjectCost, pose: np.ndarray, goal: np.ndarray, wrenches: np.ndarray, dt: float,
    way: Callable[[np.ndarray], float] = lambda pose: 0.0,
) -> tuple[float, np.ndarray]:  # fmt: skip
    """Equations 5, 6 and 15: the cost of wrenches [horizon, 3] and the poses [horizon + 1, 3]."""
    poses, cost = [pose], 0.0
    for wrench in wrenches:
        pose, force, clearance = settle(body, pose + dt / body.force * body.mobility @ wrench, dt)
        cost += object_cost(w, pose, goal, force, clearance, way(pose))
        poses.append(pose)
    return cost, np.array(poses)


@dataclass(eq=False)
class Rollout:
    """One robot rollout: terms summed over the horizon, and per step the joints, tips and object poses."""

    terms: dict[str, float] = field(default_factory=dict)
    joints: list[Any] = field(default_factory=list)
    tips: list[np.ndarray] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)

    @property
    def cost(self) -> float:
        return sum(self.terms.values())


@dataclass(frozen=True, eq=False)
class World:
    """What a robot rollout takes place in.

    Attributes:
        robot: The arm.
        speed: Joint velocity limits [rad/s].
        body: The pushed object.
        obstacles: Distance to the obstacles.
        top: Height above which no obstacle is near [m].
        weights: Of the robot level.
        dt: Control period [s].
        contact_steps: Steps of the contact model in one control step.
        topple_speed: Speed from which coming close costs [m/s].
        size: Largest distance of the object's outline from its friction centre [m].
        stance: The stance field; None if its weight is zero.
    """

    robot: Robot
    speed: np.ndarray
    body: Body
    obstacles: SpaceField
    top: float
    weights: RobotCost
    dt: float
    contact_steps: int
    topple_speed: float = 0.0
    size: float = 0.0
    stance: StanceField | None = None

    def stance_at(self, tip: np.ndarray, pose: np.ndarray, target: np.ndarray) -> float:
        """Remaining way of the tool to a good place [m]; 0 without a stance field."""
        return 0.0 if self.stance is None else stance(self.stance, tip, pose, target)

    def _turret(self) -> list[Link]:
        """The first links, as long as the heights of their frames do not depend on the joints."""
        frames = [link_frames(self.robot, np.full(len(self.robot.joints), q)) for q in (-0.4, 0.3, 0.5)]
        still = [np.ptp([frame[j][2] for frame in frames], axis=0).max() < 0.01 for j in range(len(self.robot.links))]
        return list(self.robot.links[: still.index(False) if False in still else len(still)])

    def arm_clearance(self, joints: np.ndarray, *, table: float = 0.0) -> float:
        """Clearance of arm and tool to a table at a height and the obstacles (phi_3), at most a metre [m]."""
        arm_clearance = min(1.0, tip_frame(self.robot, joints)[2, 3] - table)
        turret = sum(len(collider_spheres(c)) for link in self._turret() for c in link.colliders)
        for number, (*center, radius) in enumerate(arm_spheres(self.robot, joints)):
            if number >= turret:
                arm_clearance = min(arm_clearance, center[2] - radius - table)
            if center[2] - radius < self.top:
                arm_clearance = min(arm_clearance, space_field(self.obstacles, np.array(center)) - radius)
        return arm_clearance

    def push_along(self, pose: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The object after the tool moved from ``start`` to ``end`` in small steps."""
        way = np.linspace(start, end, self.contact_steps + 1)
        for before, after in pairwise(way):
            pose = push(self.body, pose, before, after, self.robot.tool_radius)
        return pose


@dataclass(frozen=True, eq=False)
class Placed:
    """The arm after a control: joint positions if known, the tip's frame [4, 4], phi_3 [m], the control's square."""

    joints: Any
    frame: np.ndarray
    clearance: float
    effort: float = 0.0

    @property
    def tip(self) -> np.ndarray:
        return self.frame[:3, 3]


@dataclass(frozen=True, eq=False)
class Contact:
    """Outcome of a motion of the tool for the object: its pose, lambda_2, phi_2 before, jam depth, speed of rising."""

    pose: np.ndarray
    stopped: bool = False
    above: bool = False
    force: float = 0.0
    gap: float = 1.0
    pressed: float = 0.0
    rise: float = 0.0


@dataclass(frozen=True, eq=False)
class Step:
    """A control step: the arm at rest, the arm without what stopped it, and what became of the object."""

    placed: Placed
    tried: Placed
    contact: Contact


def touch(world: World, placed: Placed, tried: Placed, pose: np.ndarray) -> Contact:
    """Outcome of the arm's motion from one placement to another, for arm and object."""
    robot, body = world.robot, world.body
    tip, new_tip, moved = placed.tip, tried.tip, pose
    above = max(tip[2], new_tip[2]) >= body.top and body.gap(pose, new_tip[:2]) < robot.tool_radius
    if (tried.clearance < -PENETRATION_TOLERANCE and tried.clearance < placed.clearance) or (
        above and new_tip[2] < body.top
    ):
        return Contact(pose, stopped=True, above=above)
    if max(tip[2], new_tip[2]) < body.top:
        moved = world.push_along(pose, tip[:2], new_tip[:2])
    if np.array_equal(moved, pose):
        return Contact(pose, above=above)
    moved, force, gap = settle(body, moved, world.dt)
    pressed = max(robot.tool_radius - body.gap(moved, new_tip[:2]), 0.0) if force > 0.0 else 0.0
    return Contact(moved, False, above, force, gap, pressed, max(new_tip[2] - tip[2], 0.0) / world.dt)


def robot_rollout(
    world: World,
    joints: np.ndarray,
    pose: np.ndarray,
    goal: np.ndarray,
    reference: np.ndarray,
    controls: np.ndarray,
) -> Rollout:
    """The whole robot level for one sequence of joint velocities [horizon, dof]; ``reference`` as the kernel has it."""
    robot = world.robot
    lower = np.minimum([joint.lower for joint in robot.joints], joints)
    upper = np.maximum([joint.upper for joint in robot.joints], joints)

    def place(at: np.ndarray, effort: float = 0.0) -> Placed:
        return Placed(at, tip_frame(robot, at), world.arm_clearance(at), effort)

    def step(placed: Placed, pose: np.ndarray, control: np.ndarray) -> Step:
        speed = np.clip(control, -world.speed, world.speed)
        tried = place(np.clip(placed.joints + world.dt * speed, lower, upper), float(speed @ speed))
        contact = touch(world, placed, tried, pose)
        if contact.stopped or contact.pressed > JAM:
            return Step(placed, tried, replace(contact, pose=pose))
        return Step(tried, tried, contact)

    return _rollout(world, place(joints), pose, goal, reference, controls, step)


def upright_rollout(
    world: World,
    upright: UprightArm,
    tip: np.ndarray,
    pose: np.ndarray,
    goal: np.ndarray,
    reference: np.ndarray,
    controls: np.ndarray,
) -> Rollout:
    """The whole robot level for one sequence of tip velocities [horizon, 3], while the tip is not being lifted."""
    body, dt, radius = world.body, world.dt, world.robot.tool_radius
    kept = pose_grid(upright.object_clearance)

    def lowered(field: SpaceField, at: np.ndarray) -> np.ndarray:
        top = field.origin[2] + (field.values.shape[2] - 1 - 1e-3) / field.inv_step
        return np.array([at[0], at[1], min(at[2], top)])

    def looked_up(field: SpaceField, at: np.ndarray) -> float:
        return space_field(field, lowered(field, at))

    def clearance(at: np.ndarray) -> float:
        return looked_up(upright.clearance, at)

    def place(at: np.ndarray, effort: float = 0.0) -> Placed:
        frame = np.diag([1.0, -1.0, -1.0, 1.0])  # straight down
        frame[:3, 3] = at
        return Placed(None, frame, clearance(at), effort)

    def unhindered(at: np.ndarray, pose: np.ndarray, control: np.ndarray) -> np.ndarray:
        most = looked_up(upright.speed, at)
        ahead = at[:2] + dt * min(1.0, most / max(np.hypot(*control[:2]), 1e-6)) * control[:2]
        height = upright.height
        if at[2] >= body.top and body.gap(pose, ahead) < radius + 0.01:
            height = at[2]
        rise = np.clip(6.0 * (height - at[2]), -0.15, 0.15)
        rise = np.clip(rise, -abs(height - at[2]) / dt, abs(height - at[2]) / dt)
        return np.array([*ahead, at[2] + dt * rise])

    def slope(value: Callable[[np.ndarray], float], at: np.ndarray, base: float) -> np.ndarray:
        """Horizontal gradient, over half a millimetre ahead."""
        return np.array([value(at + d) - base for d in 5e-4 * np.eye(3)[:2]]) / 5e-4

    def corrected(at: np.ndarray, lack: float, gradient: np.ndarray) -> np.ndarray:
        """One Newton step of the tip across the table, with a slope of at least 0.3."""
        moved = at.copy()
        moved[:2] += lack / max(gradient @ gradient, 0.09) * gradient
        return moved

    def braking(at: np.ndarray) -> float:
        return min(0.5 * upright.agility * looked_up(upright.speed, at), 10.0)

    def approached(distance: float, slower: float) -> float:
        """At most half of a distance, and no faster than the tip can stop from before its end."""
        left = max(distance, 0.0)
        speed = 0.5 * (np.sqrt(slower**2 + 8.0 * slower * left / dt) - slower)
        return min(0.5 * left, dt * speed)

    def least(before: float, margin: float, at: np.ndarray) -> float:
        """A margin is approached slowly; less than the margin does not get less."""
        return before - approached(before - margin, braking(at))

    def keep_clear(before: float, start: np.ndarray, at: np.ndarray) -> np.ndarray:
        wanted = least(before, upright.arm_margin, start)
        for _ in range(2):
            if clearance(at) < wanted:
                at = corrected(
                    at, wanted - clearance(at), space_gradient(upright.clearance, lowered(upright.clearance, at))[:2]
                )
        return at

    def within(start: np.ndarray, at: np.ndarray, longest: float) -> np.ndarray:
        way = at[:2] - start[:2]
        return np.array([*(start[:2] + min(1.0, longest / max(np.hypot(*way), 1e-9)) * way), at[2]])

    def keep_off(pose: np.ndarray, start: np.ndarray, tip: np.ndarray) -> np.ndarray:
        def gap(at: np.ndarray) -> float:
            return kept.at(world.push_along(pose, start[:2], at[:2]))[0]

        before = kept.at(pose)[0]
        wanted, longest, moved = (
            least(before, upright.object_margin, start),
            max(np.hypot(*(tip - start)[:2]), 2e-3),
            tip,
        )
        short = 5e-4 if before > upright.object_margin else 5e-5
        for _ in range(3):
            left = gap(moved)
            if left < wanted - short:
                moved = within(start, corrected(moved, wanted - left, slope(gap, moved, left)), longest)
        if gap(moved) >= wanted - short:
            return moved
        for share in (1.0, 0.5, 0.25, 0.125):  # slowly, down to contact
            moved = within(start, tip, share * longest)
            if gap(moved) >= min(before, 0.0):
                return moved
        moved = within(start, tip, longest)  # along the object, as along a wall
        for _ in range(2):
            turned = planar_rotation(pose[2])
            depth, outward = body.outline.at(turned.T @ (moved[:2] - pose[:2]))
            moved = moved + np.array([*(max(radius - depth, 0.0) * turned @ outward / np.linalg.norm(outward)), 0.0])
        return moved if gap(moved) >= min(before, 0.0) - 5e-5 else np.array([*start[:2], tip[2]])

    def approach(pose: np.ndarray, start: np.ndarray, at: np.ndarray) -> np.ndarray:
        """The tool touches slowly, and not at all while it is too high to push."""
        before, gap = body.gap(pose, start[:2]) - radius, body.gap(pose, at[:2]) - radius
        wanted = before - max(upright.touch_speed * dt, approached(before, braking(start)))
        wanted = wanted if before > 5e-4 else -np.inf
        if at[2] > upright.highest:
            wanted = max(wanted, min(0.002, before))
        if at[2] >= body.top + 0.01 or wanted <= gap or before <= -radius:
            return at
        turned = planar_rotation(pose[2])
        outward = body.outline.at(turned.T @ (at[:2] - pose[:2]))[1]
        return at + np.array([*((wanted - gap) * turned @ (outward / np.linalg.norm(outward))), 0.0])

    def step(placed: Placed, pose: np.ndarray, control: np.ndarray) -> Step:
        effort = float(control @ control)
        clear = keep_clear(placed.clearance, placed.tip, unhindered(placed.tip, pose, control))
        tried = replace(place(approach(pose, placed.tip, clear), effort), clearance=clearance(clear))
        contact = touch(world, placed, tried, pose)
        if contact.gap < 1.0:
            slow = tried.tip
            if contact.gap < 0.05:
                fastest = upright.touch_speed + 8.0 * max(contact.gap - upright.object_margin, 0.0)
                slow = within(placed.tip, slow, dt * fastest)
            tried = replace(place(keep_off(pose, placed.tip, slow), effort), clearance=tried.clearance)
            contact = touch(world, placed, tried, pose)
        end = tried.tip
        if contact.pressed > 0.0:  # back out of the object
            turned = planar_rotation(contact.pose[2])
            outward = body.outline.at(turned.T @ (end[:2] - contact.pose[:2]))[1]
            back = contact.pressed * turned @ (outward / np.linalg.norm(outward))
            end = end + np.array([*back, 0.0])
        enough = least(placed.clearance, upright.arm_margin, placed.tip) - 1e-4
        if np.any(end[:2] != clear[:2]) and clearance(end) < enough:
            above = np.array([*placed.tip[:2], clear[2]])
            return Step(place(above, effort) if clearance(above) >= enough else placed, tried, Contact(pose))
        return Step(placed if contact.stopped else place(end, effort), tried, contact)

    return _rollout(world, place(tip), pose, goal, reference, controls, step)


def _rollout(
    world: World,
    placed: Placed,
    pose: np.ndarray,
    goal: np.ndarray,
    reference: np.ndarray,
    controls: np.ndarray,
    step: Callable[[Placed, np.ndarray, np.ndarray], Step],
) -> Rollout:
    """Costs along a sequence of controls, with ``step(arm, pose, control)`` for arm and object."""
    body, dt = world.body, world.dt
    out = Rollout(dict.fromkeys(TERMS, 0.0), [placed.joints], [placed.tip], [pose])
    for h, control in enumerate(controls, start=1):
        tip, done = placed.tip, step(placed, pose, control)
        placed, tried, contact = done.placed, done.tried, done.contact
        pose = contact.pose
        target = reference[h + world.weights.align_ahead]
        terms = robot_cost(
            world.weights,
            tip=placed.tip,
            rotation=placed.frame[:3, :3],
            pose=pose,
            velocity=(tried.tip - tip)[:2] / dt,
            top=body.top,
            goal=goal,
            reference=reference[h],
            target=target,
            stance=world.stance_at(placed.tip, pose, target),
            force=contact.force,
            arm_clearance=tried.clearance,
            above=float(contact.above),
            pressed=contact.pressed,
            gap=contact.gap,
            rise=contact.rise,
            speed_squared=tried.effort,
            topple_speed=world.topple_speed,
            size=world.size,
        )
        out.terms = {name: out.terms[name] + terms[name] for name in TERMS}
        out.joints.append(placed.joints)
        out.tips.append(placed.tip)
        out.poses.append(pose)
    return out


# The cross-entropy method


def elite_weights(costs: np.ndarray, elites: int) -> np.ndarray:
    """Equal weights for the cheapest of the costs [sample]; those as dear as the last of them share what is left."""
    costs = np.where(np.isfinite(costs) & (costs < 1e30), costs, np.inf)
    elites = min(elites, int(np.isfinite(costs).sum()))
    if elites == 0:
        return np.zeros(len(costs))
    last = np.sort(costs)[elites - 1]
    cheaper, equal = costs < last, costs == last
    return (cheaper + equal * (elites - cheaper.sum()) / equal.sum()) / elites


def elite_fit(
    controls: np.ndarray, perturbations: np.ndarray, weights: np.ndarray, old: np.ndarray, *, smoothing: float,
    least: float,
) -> np.ndarray:  # fmt: skip
    """Nominal and deviation [2, horizon, m] fitted to weighted controls and perturbations [sample, horizon, m]."""
    mean = np.einsum("k,khi->hi", weights, controls)
    apart = perturbations - np.einsum("k,khi->hi", weights, perturbations)
    spread = np.sqrt(np.einsum("k,khi->hi", weights, apart**2))
    nominal, deviation = smoothing * old + (1.0 - smoothing) * np.stack([mean, spread])
    return np.stack([nominal, np.clip(deviation, least, 1.0)])
