"""A filter between planner and plant: changes commands that would take the arm into something, or a joint to its limit.

Whatever planned a command, a small quadratic program projects it onto the joint velocities that keep the arm's
distances. The planners here know most of these bounds and keep them by themselves; the filter holds any planner to
them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from oimppi_warp.config.settings import Safety
from oimppi_warp.geometry.kinematics import tip_jacobian
from oimppi_warp.observation import BEYOND_LIMITS, beyond_limits
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.scene import Scene

_SHARE = 0.5
"""Largest share of a distance, in excess of the margin, that one control period may take away."""
_BRAKING = 0.3
"""Share of the largest change of the joint velocities that is counted on for braking; the rest is left for turning."""
_SEEN = 0.3
"""Distance within which shapes are looked at once a command has to be changed [m]."""
_BACK, _SLOWLY = 2.0, 0.01
"""Rate at which a distance below the margin is restored [1/s], and its largest speed [m/s, rad/s]."""
_EASILY = 0.03
"""Velocities of the joints that restoring a distance may take [rad/s; m/s for a prismatic joint]."""
_AT_LEAST = 0.1
"""Velocity that the filter may give to a joint, even if none is as fast in the command [rad/s; m/s]."""
_ROUNDING = 1e-6
"""Amount by which a command may exceed a bound and pass unchanged [m/s, rad/s]."""
_JOINTS = 1e-2
"""Weight of a change of the joints' velocities [s^2/rad^2], where that of the tool's velocity is one [s^2/m^2]."""
_SOLVED, _SOFTLY = 1, 2
"""Exit flags of the solver for an optimal solution, and for one that exceeds soft constraints."""
_SOFT = 8
"""The solver's code of a soft constraint."""


@dataclass(frozen=True, eq=False)
class Filtered:
    """A command as the filter lets it pass.

    Attributes:
        joint_velocity: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].
        reason: Bounds that the command was changed for, such as ``"link5 and the table"``; empty if it was not changed.
        problem: Why the arm is stopped, if no command keeps all bounds; else empty.
        nearest: Nearest points of the shapes that it was changed for, shape [n, 2, 3] [m].
    """

    joint_velocity: np.ndarray
    reason: str = ""
    problem: str = ""
    nearest: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))

    @property
    def stopped(self) -> bool:
        """Returns whether the arm is being stopped."""
        return bool(self.problem)


@dataclass(frozen=True, eq=False)
class _Bounds:
    """Bounds of the joint velocities.

    Attributes:
        lower, upper: Those of each joint, shape [dof] [rad/s].
        rows: Coefficients of the speeds at which distances grow, shape [n, dof] [m/rad].
        least: Lower bounds of these speeds, shape [n] [m/s].
        names: What each keeps apart.
        nearest: Nearest points of these, shape [n, 2, 3] [m].
    """

    lower: np.ndarray
    upper: np.ndarray
    rows: np.ndarray
    least: np.ndarray
    names: list[str]
    nearest: np.ndarray

    def exceeded_by(self, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the joints, and the rows, whose bounds joint velocities [dof] exceed: two arrays of indices."""
        beyond = np.maximum(self.lower - velocity, velocity - self.upper) > _ROUNDING
        near = self.rows @ velocity < self.least - _ROUNDING
        return np.flatnonzero(beyond), np.flatnonzero(near)


class SafetyFilter:
    """Projects joint velocities onto those that keep the arm off table, obstacles, itself and its joints' limits.

    Each distance may shrink by no more than half of its excess over the margin in a control period, and no faster than
    the arm can brake; one that is below the margin is slowly restored. The same holds for the joints' distances to
    their limits. Of the joint velocities that do so, within the limits of velocity and acceleration, the filter takes
    those that change the tool's motion least. If there are none, it brings the arm to rest, and exceeds the bounds as
    little as the limit of acceleration allows. A command within the bounds passes unchanged.

    The object is no obstacle. Neighbouring links, and links within the margin of each other at the start posture, are
    not kept apart.

    Args:
        scene: The arm and its surroundings.
        safety: Margin, and limits of acceleration and jerk.
        period: Control period [s].

    The bounds on distances are the velocity dampers of Faverjon and Tournassoud, "A local based approach for path
    planning of manipulators with a high number of degrees of freedom", ICRA 1987.
    """

    def __init__(self, scene: Scene, safety: Safety, period: float) -> None:
        import mujoco

        made = World(scene).mujoco
        self._model, self._data = made.model, mujoco.MjData(made.model)
        self._robot, self._qpos, self._qvel = scene.robot, made.joint_qpos, made.joint_qvel
        self._margin, self._period, self._most = safety.margin, period, safety.most_change(period)
        joints = scene.robot.joints
        self._lower, self._upper = np.array([j.lower for j in joints]), np.array([j.upper for j in joints])
        self._speed = np.array([j.velocity_limit for j in joints])
        roles = np.array([ROLES[role] for role in made.roles])
        self._names = [_name(self._model.geom(geom).name, role) for geom, role in enumerate(roles)]
        moving = np.flatnonzero(np.isin(roles, ["arm", "tool"]))
        still = np.flatnonzero(np.isin(roles, ["table", "obstacle"]))
        pairs = [(int(a), int(b)) for a in moving for b in still]
        self._place(scene.robot.start)
        self._joint = self._model.dof_jntid[made.joint_qvel]
        self._sliding = self._model.jnt_type[self._joint] == mujoco.mjtJoint.mjJNT_SLIDE
        links = self._links(made.link_bodies)
        self._moved = links[:, None] >= np.arange(len(joints))  # [geom, joint]
        own = [*moving.tolist(), *np.flatnonzero(roles == "base").tolist()]
        apart = [(a, b) for a in own for b in own if links[a] - links[b] >= 2]
        pairs += [pair for pair in apart if self._distance(*pair)[0] > safety.margin]
        self._pairs = np.array(pairs, dtype=int).reshape(-1, 2)
        self._boxes = self._model.geom_type[self._pairs[:, 1]] == mujoco.mjtGeom.mjGEOM_BOX

    def project(self, joints: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> Filtered:
        """Returns the joint velocities nearest to the wanted ones that are allowed for a control period.

        Args:
            joints: Joint positions where the command takes effect, shape [dof] [rad; m for a prismatic joint].
            wanted: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].
            before: Joint velocities in the period before, likewise.
        """
        import daqp

        if not np.isfinite(joints).all() or (beyond_limits(self._robot, joints) > BEYOND_LIMITS).any():
            problem = "the joint positions cannot be true"
            return Filtered(self._braked(before), problem, problem=problem)
        self._place(joints)
        gaps, needed = self._least_distances(), self._needed(wanted)
        beyond, near = self._bounds(joints, gaps < needed).exceeded_by(wanted)
        if not len(beyond) and not len(near):
            return Filtered(wanted)
        bounds = self._bounds(joints, gaps < np.maximum(needed, _SEEN))
        beyond, near = bounds.exceeded_by(wanted)
        names = [*(f"the limit of joint {j + 1}" for j in beyond), *(bounds.names[i] for i in near)]
        reason, nearest = ", ".join(dict.fromkeys(names)), bounds.nearest[near]
        # The nearest motion of the tool. The drive limits accelerations: here they only bound the search.
        jacobian = tip_jacobian(self._robot, joints)[:3]
        cost = jacobian.T @ jacobian + _JOINTS * np.eye(len(wanted))
        slowest, fastest = before - self._most, before + self._most
        now = float(np.abs(before).max())
        cap = max(now, float(np.abs(wanted).max()), _AT_LEAST)
        low = np.maximum(np.maximum(bounds.lower, slowest), -cap)
        high = np.minimum(np.minimum(bounds.upper, fastest), cap)
        any_speed = np.full(len(bounds.least), np.inf)
        if (low <= high).all():
            most, least = np.concatenate([high, any_speed]), np.concatenate([low, bounds.least])
            found, _, flag, _ = daqp.solve(cost, -cost @ wanted, bounds.rows, most, least)
            if flag == _SOLVED:
                return Filtered(np.asarray(found), reason, nearest=nearest)
        # Nothing keeps all bounds: come to rest, and exceed them as little as possible on the way.
        low, high = np.maximum(slowest, -now), np.minimum(fastest, now)
        rows = np.vstack([np.eye(len(wanted)), bounds.rows])
        most = np.concatenate([high, np.maximum(bounds.upper, 0.0), any_speed])
        least = np.concatenate([low, np.minimum(bounds.lower, 0.0), np.minimum(bounds.least, 0.0)])
        sense = np.concatenate([np.zeros(len(wanted), np.int32), np.full(len(rows), _SOFT, np.int32)])
        found, _, flag, _ = daqp.solve(cost, np.zeros(len(wanted)), rows, most, least, sense)
        braked = np.asarray(found) if flag in (_SOLVED, _SOFTLY) else self._braked(before)
        problem = f"no command within the limits of acceleration keeps these bounds: {reason}"
        return Filtered(braked, reason, problem=problem, nearest=nearest)

    def _bounds(self, joints: np.ndarray, seen: np.ndarray) -> _Bounds:
        """Returns the bounds of the joint velocities at joint positions [dof], for the pairs marked in ``seen``."""
        change = np.full(len(joints), self._most)
        upper = np.minimum(self._speed, self._closest(self._upper - joints, change))
        lower = -np.minimum(self._speed, self._closest(joints - self._lower, change))
        rows, distances, names, nearest = [], [], [], []
        for a, b in self._pairs[seen]:
            distance, ends = self._distance(a, b)
            if distance != 0.0:  # where they just touch, there is no direction
                toward = (ends[1] - ends[0]) / distance
                rows.append(toward @ (self._jacobian(b, ends[1]) - self._jacobian(a, ends[0])))
                distances.append(distance - self._margin)
                names.append(f"{self._names[a]} and {self._names[b]}")
                nearest.append(ends)
        found = np.array(rows).reshape(-1, len(joints))
        slower = np.abs(found).sum(axis=1) * self._most if np.isfinite(self._most) else np.full(len(found), np.inf)
        # What is too close is restored only as far as the joints can do so easily, if they can at all.
        easily = _EASILY * np.abs(found).sum(axis=1)
        least = np.minimum(-self._closest(np.array(distances), slower), easily)
        return _Bounds(lower, upper, found, least, names, np.array(nearest).reshape(-1, 2, 3))

    def _closest(self, distances: np.ndarray, slower: np.ndarray) -> np.ndarray:
        """Returns the largest speeds at which distances may shrink, which a period can reduce by ``slower``.

        It is negative for a distance below zero, which has to grow.
        """
        left = np.maximum(distances, 0.0)
        b = _BRAKING * np.minimum(slower, 1e3)
        speed = np.minimum(_SHARE * left / self._period, 0.5 * (np.sqrt(b * b + 8.0 * b * left / self._period) - b))
        return speed - np.minimum(_BACK * np.maximum(-distances, 0.0), _SLOWLY)

    def _braked(self, before: np.ndarray) -> np.ndarray:
        """Returns the velocities before, all reduced by the same factor as far as the limit of acceleration allows."""
        most = float(np.abs(before).max())
        return before * max(1.0 - self._most / most, 0.0) if most > 0.0 else np.zeros_like(before)

    def _needed(self, wanted: np.ndarray) -> np.ndarray:
        """Returns distances of the pairs from which on joint velocities are surely allowed, shape [pair] [m].

        No point of a shape is faster than its farthest one about each joint. A speed ``v`` of approach is allowed from
        ``v period (v / b + 1) / 2`` on, and from ``v period / share`` on, with ``b`` as in :meth:`_closest`; ``v / b``
        is no larger than the joint velocities over the change of velocity that is counted on.
        """
        arms = np.linalg.norm(self._data.geom_xpos[:, None] - self._data.xanchor[self._joint], axis=2)
        arms = np.where(self._sliding, 1.0, arms + self._model.geom_rbound[:, None]) * self._moved
        speed = (arms @ np.abs(wanted))[self._pairs].sum(axis=1)
        steps = 0.5 * (np.abs(wanted).max() / (_BRAKING * self._most) + 1.0)
        return self._margin + speed * self._period * max(steps, 1.0 / _SHARE)

    def _links(self, link_bodies: np.ndarray) -> np.ndarray:
        """Returns the link that each shape moves with, shape [geom]; -1 for what does not move with the arm."""
        index = {int(body): i for i, body in enumerate(link_bodies)}
        links = []
        for start in self._model.geom_bodyid:
            body = int(start)
            while body and body not in index:  # a body that is welded to a link
                body = int(self._model.body_parentid[body])
            links.append(index.get(body, -1))
        return np.array(links)

    def _least_distances(self) -> np.ndarray:
        """Returns lower bounds of the pairs' distances, those of spheres (or the second's box) around them [m]."""
        first, second = self._pairs.T
        apart = self._data.geom_xpos[first] - self._data.geom_xpos[second]
        gaps = np.linalg.norm(apart, axis=1) - self._model.geom_rbound[second]
        boxes = second[self._boxes]
        local = np.einsum("nij,ni->nj", self._data.geom_xmat[boxes].reshape(-1, 3, 3), apart[self._boxes])
        gaps[self._boxes] = np.linalg.norm(np.maximum(np.abs(local) - self._model.geom_size[boxes], 0.0), axis=1)
        return gaps - self._model.geom_rbound[first]

    def _place(self, joints: np.ndarray) -> None:
        import mujoco

        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def _distance(self, a: int, b: int) -> tuple[float, np.ndarray]:
        """Returns the distance of two shapes [m] and their nearest points, shape [2, 3] [m]."""
        import mujoco

        ends = np.zeros(6)
        distance = mujoco.mj_geomDistance(self._model, self._data, a, b, np.inf, ends)
        return distance, ends.reshape(2, 3)

    def _jacobian(self, geom: int, point: np.ndarray) -> np.ndarray:
        """Returns the Jacobian of a point of a shape, shape [3, dof] [m/rad]."""
        import mujoco

        jacobian = np.zeros((3, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian, None, point, self._model.geom_bodyid[geom])
        return jacobian[:, self._qvel]


def _name(path: str, role: str) -> str:
    """Returns what a shape is called in a message, from the path of its collider and its role."""
    parts = path.rsplit("/", 2)
    if role == "obstacle":
        return f"the obstacle {parts[-1].rsplit('_', 1)[0]}"
    return f"the {role}" if role != "arm" or len(parts) < 3 else parts[-2]
