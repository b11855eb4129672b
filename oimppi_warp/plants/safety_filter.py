"""A filter between planner and plant: changes commands that would take the arm into something, or a joint to its limit.

Whatever planned a command, a small quadratic program projects it onto the joint velocities that keep the arm's
distances. The planners here know most of these bounds and keep them by themselves; the filter holds any planner to
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oimppi_warp.config.settings import Safety
from oimppi_warp.geometry.kinematics import tip_jacobian
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.scene import Scene

_SHARE = 0.5
"""Largest share of a distance, in excess of the margin, that one control period may take away."""
_BRAKING = 0.3
"""Share of the largest change of the joint velocities that is counted on for braking; the rest is left for turning."""
_SEEN = 0.15
"""Distance beyond which nothing is looked at [m]."""
_BACK, _SLOWLY = 2.0, 0.01
"""Rate at which a distance below the margin is restored [1/s], and its largest speed [m/s, rad/s]."""
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
        stopped: Whether no command keeps all bounds, so that the arm is stopped.
    """

    joint_velocity: np.ndarray
    reason: str = ""
    stopped: bool = False


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
        own = self._apart(made.link_bodies, [*moving, *np.flatnonzero(roles == "base")])
        pairs += [pair for pair in own if self._distance(*pair)[0] > safety.margin]
        self._pairs = np.array(pairs, dtype=int).reshape(-1, 2)
        # A plane's bounding radius is zero, and the table's is that of all of it: they are always looked at.
        self._with_table = (roles[self._pairs] == "table").any(axis=1)  # its bounding sphere says nothing

    def project(self, joints: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> Filtered:
        """Returns the joint velocities nearest to the wanted ones that are allowed for a control period.

        Args:
            joints: Joint positions where the command takes effect, shape [dof] [rad; m for a prismatic joint].
            wanted: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].
            before: Joint velocities in the period before, likewise.
        """
        import daqp

        if not np.isfinite(joints).all():
            return Filtered(self._braked(before), "joint positions that are not known", stopped=True)
        lower, upper, rows, least, names = self._bounds(joints)
        if self._kept(wanted, lower, upper, rows, least):
            return Filtered(wanted)
        # The limit of acceleration is the drive's, which scales the whole change down: here it only bounds the search.
        low, high = np.maximum(lower, before - self._most), np.minimum(upper, before + self._most)
        jacobian = tip_jacobian(self._robot, joints)[:3]
        cost = jacobian.T @ jacobian + _JOINTS * np.eye(len(wanted))
        flag, found = -1, wanted
        most = np.full(len(least), np.inf)
        if (low <= high).all():
            found, _, flag, _ = daqp.solve(
                cost, -cost @ wanted, rows, np.concatenate([high, most]), np.concatenate([low, least])
            )
        at_limit = [f"the limit of joint {j + 1}" for j in range(len(wanted)) if not lower[j] <= wanted[j] <= upper[j]]
        near = [name for name, row, bound in zip(names, rows, least, strict=True) if row @ wanted < bound - _ROUNDING]
        reason = ", ".join(dict.fromkeys([*at_limit, *near]))
        if flag == _SOLVED:
            return Filtered(np.asarray(found), reason)
        # Nothing keeps all bounds: come to rest, and exceed them as little as possible on the way.
        low, high = before - self._most, before + self._most
        rows = np.vstack([np.eye(len(wanted)), rows])
        soft = np.concatenate([np.zeros(len(wanted), np.int32), np.full(len(rows), _SOFT, np.int32)])
        found, _, flag, _ = daqp.solve(
            cost,
            np.zeros(len(wanted)),
            rows,
            np.concatenate([high, upper, most]),
            np.concatenate([low, lower, least]),
            soft,
        )
        return Filtered(np.asarray(found) if flag in (_SOLVED, _SOFTLY) else self._braked(before), reason, stopped=True)

    def _bounds(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list[str]]:
        """Returns the bounds of the joint velocities, and those of linear combinations of them.

        Returns:
            Lower and upper bounds, shape [dof]; the coefficients of the combinations, shape [n, dof], with their lower
            bounds, shape [n], and what each keeps apart.
        """
        upper = np.minimum(self._speed, self._closest(self._upper - joints, np.full(len(joints), self._most)))
        lower = -np.minimum(self._speed, self._closest(joints - self._lower, np.full(len(joints), self._most)))
        self._place(joints)
        centers, radii = self._data.geom_xpos[self._pairs], self._model.geom_rbound[self._pairs]
        gaps = np.linalg.norm(centers[:, 0] - centers[:, 1], axis=1) - radii.sum(axis=1)
        rows, distances, names = [], [], []
        for a, b in self._pairs[self._with_table | (gaps < _SEEN)]:
            distance, ends = self._distance(a, b)
            if 0.0 != distance < _SEEN:
                toward = (ends[1] - ends[0]) / distance
                rows.append(toward @ (self._jacobian(b, ends[1]) - self._jacobian(a, ends[0])))
                distances.append(distance - self._margin)
                names.append(f"{self._names[a]} and {self._names[b]}")
        found = np.array(rows).reshape(-1, len(joints))
        slower = np.abs(found).sum(axis=1) * self._most if np.isfinite(self._most) else np.full(len(found), np.inf)
        return lower, upper, found, -self._closest(np.array(distances), slower), names

    def _closest(self, distances: np.ndarray, slower: np.ndarray) -> np.ndarray:
        """Returns the largest speeds at which distances may shrink, which a period can reduce by ``slower``.

        It is negative for a distance below zero, which has to grow.
        """
        left = np.maximum(distances, 0.0)
        b = _BRAKING * np.minimum(slower, 1e3)
        speed = np.minimum(_SHARE * left / self._period, 0.5 * (np.sqrt(b * b + 8.0 * b * left / self._period) - b))
        return speed - np.minimum(_BACK * (left - distances), _SLOWLY)

    def _kept(
        self, wanted: np.ndarray, lower: np.ndarray, upper: np.ndarray, rows: np.ndarray, least: np.ndarray
    ) -> bool:
        within = (wanted >= lower - _ROUNDING).all() and (wanted <= upper + _ROUNDING).all()
        return bool(within and (rows @ wanted >= least - _ROUNDING).all())

    def _braked(self, before: np.ndarray) -> np.ndarray:
        """Returns the velocities before, all reduced by the same factor as far as the limit of acceleration allows."""
        most = float(np.abs(before).max())
        return before * max(1.0 - self._most / most, 0.0) if most > 0.0 else np.zeros_like(before)

    def _apart(self, link_bodies: np.ndarray, geoms: Sequence[int]) -> list[tuple[int, int]]:
        """Returns the pairs of the arm's shapes that are on links which are not neighbours."""
        index = {int(body): i for i, body in enumerate(link_bodies)}

        def link(geom: int) -> int:
            body = int(self._model.geom_bodyid[geom])
            while body and body not in index:
                body = int(self._model.body_parentid[body])
            return index.get(body, -1)

        links = {int(geom): link(geom) for geom in geoms}
        return [(a, b) for a in links for b in links if links[a] - links[b] >= 2]

    def _place(self, joints: np.ndarray) -> None:
        import mujoco

        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def _distance(self, a: int, b: int) -> tuple[float, np.ndarray]:
        """Returns the distance of two shapes [m] and their nearest points, shape [2, 3] [m]."""
        import mujoco

        ends = np.zeros(6)
        distance = mujoco.mj_geomDistance(self._model, self._data, a, b, _SEEN, ends)
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
    return f"the {role}" if role in ("table", "base") or len(parts) < 3 else parts[-2]
