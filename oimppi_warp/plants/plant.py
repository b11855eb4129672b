"""The plant: the interface between a planner and an arm, and the simulated arm.

A planner and a plant exchange only observations and joint velocities.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import Protocol, runtime_checkable

import numpy as np

from oimppi_warp.config.settings import Config
from oimppi_warp.observation import Observation, planar_pose, planar_transform
from oimppi_warp.physics.newton_model import ROLES
from oimppi_warp.physics.world import World
from oimppi_warp.scene import PlanarPose, Scene

UPRIGHT = math.cos(0.35)
"""Vertical component of the object's z axis below which it counts as tipped."""

LONGEST_STEP = 0.0025
"""Longest physics step of the plant [s]; with longer ones a sliding object gains energy."""

_PAIRS = (
    (("tool",), ("object",)),
    (("object",), ("obstacle", "base")),
    (("arm", "tool"), ("obstacle", "table")),
    (("object",), ("table",)),
)
"""Pairs of roles covered by each field of :class:`Contacts`, in its order."""


@dataclass(frozen=True)
class Contacts:
    """Largest normal forces within the last control period [N].

    At each instant, the forces at all contact points of a pair are added up.

    Attributes:
        tool_object: Between tool and object.
        object_obstacle: Between the object and obstacles or the robot's base.
        robot_obstacle: Between arm or tool and obstacles or table.
        object_table: Between object and table; about the object's weight while it lies still and nothing else
            touches it.
    """

    tool_object: float
    object_obstacle: float
    robot_obstacle: float
    object_table: float


@dataclass(frozen=True)
class Verdict:
    """A plant's own judgement of the task so far.

    Attributes:
        success: Whether the task is done.
        over: Whether the plant has ended the episode, for example at its own time limit.
        scores: Figures of merit by name.
    """

    success: bool
    over: bool
    scores: dict[str, float]


class Plant(Protocol):
    """An arm controlled by joint velocities, together with its surroundings, as seen by a planner.

    Only the members below are required. A plant may also have ``latency``, the time from a command to its effect [s]
    (:func:`latency_of`), and ``own_world`` (:func:`has_own_world`), and implement :class:`StreamingPlant`,
    :class:`TruthfulPlant`, :class:`ContactPlant`, :class:`MovablePlant`, :class:`JudgingPlant` and :class:`RealPlant`.

    Attributes:
        control_period: Duration of one command, and of a planner's time steps [s].
    """

    control_period: float

    def observe(self) -> Observation:
        """Returns the current observation."""
        ...

    def apply(self, joint_velocity: np.ndarray) -> None:
        """Moves with joint velocities, shape [dof] [rad/s; m/s for a prismatic joint], for one control period.

        In lock step, the period must be over when this returns; in real time, the control loop waits for its end.
        """
        ...


@runtime_checkable
class StreamingPlant(Protocol):
    """A plant that takes several joint velocities per control period, so that they can change smoothly.

    Attributes:
        ticks: Number of joint velocities per control period.
    """

    ticks: int

    def stream(self, joint_velocities: np.ndarray) -> None:
        """Moves for one control period with joint velocities, shape [ticks, dof], each for an equal part of it.

        In lock step, the period must be over when this returns; in real time, the control loop waits for its end.
        """
        ...


@runtime_checkable
class TruthfulPlant(Protocol):
    """A plant that knows its exact state, such as a simulator. It is for the record; planners must not use it."""

    def truth(self) -> Observation:
        """Returns the exact state."""
        ...


@runtime_checkable
class ContactPlant(Protocol):
    """A plant that measures contact forces."""

    @property
    def contacts(self) -> Contacts:
        """Returns the largest contact forces within the last control period."""
        ...


@runtime_checkable
class MovablePlant(Protocol):
    """A plant whose arm and object can be placed and whose object can be pushed, as the viewer does."""

    def place(self, joint_position: np.ndarray, object_transform: np.ndarray) -> None:
        """Places arm and object, at rest.

        Args:
            joint_position: Joint positions, shape [dof] [rad; m for a prismatic joint].
            object_transform: Position [m] and quaternion xyzw of the object's frame in the world, shape [7].
        """
        ...

    def knock(self, impulse: np.ndarray) -> None:
        """Applies an impulse to the object at its centre of mass, in the world frame, shape [3] [N s]."""
        ...

    @property
    def contact_points(self) -> np.ndarray:
        """Returns the contact points [m] and normal forces [N] in the world frame, shape [n, 6]: 3 numbers each."""
        ...


@runtime_checkable
class JudgingPlant(Protocol):
    """A plant that decides itself when the task is done, such as the environment of a benchmark."""

    @property
    def verdict(self) -> Verdict:
        """Returns the verdict after the last control period; its scores always have the same names."""
        ...


@dataclass(frozen=True)
class StopRules:
    """Rules of a real plant for stopping and going on.

    Attributes:
        pose_timeout: Age of the object's pose from which on the arm is stopped [s].
        jump: Distance from where the object is believed, from which on a detection stops the arm [m].
        resume: Whether the arm goes on by itself once the reason for a stop has been gone for a while, if the reason is
            one that passes by itself: poses, plans and reports that did not come. If not, somebody has to ask for it.
    """

    pose_timeout: float = 2.5
    jump: float = 0.1
    resume: bool = False


@runtime_checkable
class RealPlant(Protocol):
    """A plant that is a machine: it runs in real time only, its reports can fail, and somebody may stand next to it.

    Attributes:
        rules: Its rules for stopping and going on.
    """

    rules: StopRules

    def limited(self, config: Config) -> Config:
        """Returns settings with which plans keep to the speed that the plant allows."""
        ...

    def surveyed(self, scene: Scene) -> Scene:
        """Returns a task with the obstacles where the plant found them."""
        ...

    @property
    def now(self) -> float:
        """Returns the present time, on the clock of its observations [s]."""
        ...

    @property
    def fault(self) -> str:
        """Returns why the arm must not move, in words, with what to do; empty if it may.

        With the first fault the plant stops the arm by itself, and takes no command before :meth:`recover`.
        """
        ...

    @property
    def blind(self) -> str:
        """Returns why poses of the object do not arrive, or cannot be used; empty if nothing is known of it."""
        ...

    @property
    def fault_passes(self) -> bool:
        """Returns whether the present fault may pass by itself; after any other one, a person has to ask to go on."""
        ...

    def recover(self) -> None:
        """Gets ready to move again after a fault.

        Raises:
            HardwareError: It cannot.
        """
        ...

    def close(self) -> None:
        """Stops the arm for good, whatever state it is in, and ends the connection. It raises nothing."""
        ...


def is_real(plant: object) -> bool:
    """Returns whether a plant, or its class, is a :class:`RealPlant`."""
    return isinstance(getattr(plant, "rules", None), StopRules)


def has_own_world(plant: object) -> bool:
    """Returns whether a plant, or its class, places arm and object itself and has a friction of its own."""
    return bool(getattr(plant, "own_world", False))


def latency_of(plant: Plant) -> float:
    """Returns the time from a command to its effect [s]; 0 if the plant does not define it."""
    return float(getattr(plant, "latency", 0.0))


def checked_stream(joint_velocities: np.ndarray, ticks: int) -> np.ndarray:
    """Returns joint velocities as an array of shape [ticks, dof].

    Raises:
        ValueError: A velocity is not finite, or their number is wrong.
    """
    velocities = np.array(joint_velocities, dtype=float)
    if len(velocities) != ticks:
        raise ValueError(f"expected {ticks} joint velocities, one per tick, got {len(velocities)}")
    finite = np.isfinite(velocities).all(axis=1)
    if not finite.all():
        raise ValueError(f"joint velocities must be finite, got {velocities[~finite][0]}")
    return velocities


def has_tipped(object_transform: np.ndarray) -> bool:
    """Returns whether an object with this transform (position [m], quaternion xyzw), shape [7], is no longer flat."""
    x, y = object_transform[3:5]
    return bool(1 - 2 * (x * x + y * y) < UPRIGHT)


class SimulatedPlant:
    """The scene in MuJoCo's C engine: rigid bodies, friction, velocity drives at the joints, gravity compensation.

    A flat object slides correctly only with certain settings, verified in ``tests/plants/test_plant.py``: the object on
    a free joint, implicit integration, elliptic friction cones, contacts with a soft onset, steps of 2.5 ms.

    Args:
        world: The scene; many plants can share it.
        start: The object's start pose: x, y, yaw [m, m, rad]; ``None``: the scene's.
        control_period: Control period [s].
        substeps: Physics steps per control period.

    Attributes:
        latency: Zero.
        ticks: Number of joint velocities per control period: one per physics step.
        model, data: MuJoCo's model and data, for tests and pictures; :attr:`World.mujoco` has the addresses of the
            joints and the object.
    """

    latency = 0.0

    def __init__(
        self,
        world: World,
        *,
        start: PlanarPose | None = None,
        control_period: float = 0.05,
        substeps: int = 20,
    ) -> None:
        import mujoco

        self.control_period = control_period
        self._mj_step = mujoco.mj_step
        self._fatal = tuple(getattr(mujoco.mjtWarning, f"mjWARN_BAD{name}") for name in ("QPOS", "QVEL", "QACC"))
        self._map = world.mujoco
        self.model = copy(self._map.model)
        self.model.opt.timestep = control_period / substeps
        self.data = mujoco.MjData(self.model)
        self.ticks = substeps
        self._touch = _pair_table()
        self._contacts = Contacts(0.0, 0.0, 0.0, 0.0)
        joints = world.scene.robot.joints
        self._limits = np.array([(joint.lower, joint.upper, joint.velocity_limit) for joint in joints]).T

        self._mj_forward = mujoco.mj_forward
        free_joint = np.flatnonzero(self.model.jnt_qposadr == self._map.object_qpos[0])[0]
        self._object_body = int(self.model.jnt_bodyid[free_joint])
        self._knock = np.zeros(3)  # a force that lasts one control period [N]
        transform = planar_transform(world.scene.start if start is None else start, world.scene.object.rest_height)
        self.place(world.scene.robot.start, transform)

    def place(self, joint_position: np.ndarray, object_transform: np.ndarray) -> None:
        """Places arm and object, at rest.

        Args:
            joint_position: Joint positions, shape [dof] [rad; m for a prismatic joint].
            object_transform: Position [m] and quaternion xyzw of the object's frame in the world, shape [7].
        """
        self.data.qpos[self._map.joint_qpos] = joint_position
        self.data.qpos[self._map.object_qpos] = np.asarray(object_transform)[[0, 1, 2, 6, 3, 4, 5]]
        self.data.qvel[:] = 0.0
        self._mj_forward(self.model, self.data)

    def knock(self, impulse: np.ndarray) -> None:
        """Applies an impulse to the object's centre of mass, spread over the next control period.

        Args:
            impulse: Impulse in the world frame, shape [3] [N s].
        """
        self._knock += np.asarray(impulse) / self.control_period

    def observe(self) -> Observation:
        """Returns the exact current state."""
        qpos, qvel = self.data.qpos, self.data.qvel
        transform = qpos[self._map.object_qpos][[0, 1, 2, 4, 5, 6, 3]]
        return Observation(
            time=float(self.data.time),
            joint_position=qpos[self._map.joint_qpos],
            joint_velocity=qvel[self._map.joint_qvel],
            object_pose=planar_pose(transform),
            object_transform=transform,
        )

    def truth(self) -> Observation:
        """Returns the exact state, for the record; here the same as the observation."""
        return self.observe()

    def apply(self, joint_velocity: np.ndarray) -> None:
        """Drives the joints for one control period, within their velocity and position limits.

        Impulses given to :meth:`knock` since the last call act in this period.

        Args:
            joint_velocity: Joint velocities, shape [dof] [rad/s; m/s for a prismatic joint].

        Raises:
            ValueError: The command is not finite.
            FloatingPointError: The simulation diverged.
        """
        self.stream(np.tile(np.asarray(joint_velocity, dtype=float), (self.ticks, 1)))

    def stream(self, joint_velocities: np.ndarray) -> None:
        """Drives the joints for one control period, with one joint velocity per physics step.

        Args:
            joint_velocities: Joint velocities, shape [ticks, dof] [rad/s; m/s for a prismatic joint].

        Raises:
            ValueError: A velocity is not finite, or their number is wrong.
            FloatingPointError: The simulation diverged.
        """
        commands = checked_stream(joint_velocities, self.ticks)
        lower, upper, speed = self._limits
        position = self.data.qpos[self._map.joint_qpos]
        commands = np.clip(commands, (lower - position) / self.control_period, (upper - position) / self.control_period)
        commands = np.clip(commands, -speed, speed)
        forces = np.zeros(len(_PAIRS))
        knocked = self.data.xfrc_applied[self._object_body, :3]
        knocked += self._knock
        for command in commands:
            self.data.ctrl[self._map.joint_drive] = command
            self._mj_step(self.model, self.data)
            forces = np.maximum(forces, self._normal_forces())
        knocked -= self._knock
        self._knock = np.zeros(3)
        if any(self.data.warning[warning].number for warning in self._fatal):
            raise FloatingPointError(f"the simulation diverged before {self.data.time:.3f} s")
        self._contacts = Contacts(*forces.tolist())

    @property
    def contacts(self) -> Contacts:
        """Returns the largest contact forces in the physics steps of the last control period."""
        return self._contacts

    @property
    def contact_points(self) -> np.ndarray:
        """Returns the contact points [m] and normal forces [N] in the world frame, shape [n, 6]: 3 numbers each.

        Contacts between the object and the table are omitted.
        """
        contact = self.data.contact
        active = contact.efc_address >= 0
        pair = self._touch[tuple(self._map.roles[contact.geom[active]].T)]
        force = self.data.efc_force[contact.efc_address[active]]
        vectors = force[:, None] * contact.frame[active][:, :3]
        return np.column_stack([contact.pos[active], vectors])[pair < len(_PAIRS) - 1]

    @property
    def tipped(self) -> bool:
        """Returns whether the object no longer lies flat."""
        return has_tipped(self.truth().object_transform)

    def _normal_forces(self) -> np.ndarray:
        """Returns the sum of the normal forces of each pair in :data:`_PAIRS`, shape [pair] [N]."""
        contact = self.data.contact
        active = contact.efc_address >= 0
        pair = self._touch[tuple(self._map.roles[contact.geom[active]].T)]
        normal = self.data.efc_force[contact.efc_address[active]]
        return np.bincount(pair, weights=normal, minlength=len(_PAIRS) + 1)[:-1]


def ideal_plant(scene: Scene, config: Config, *, seed: int = 0) -> SimulatedPlant:
    """Makes the plant ``ideal``, the simulation without imperfections; it ignores the seed."""
    period = config.control_period
    substeps = math.ceil(period / LONGEST_STEP - 1e-6)
    return SimulatedPlant(World(scene), start=scene.start, control_period=period, substeps=substeps)


def _pair_table() -> np.ndarray:
    """Returns the index in :data:`_PAIRS` of each pair of roles, ``len(_PAIRS)`` if in none; shape [role, role]."""
    table = np.full((len(ROLES), len(ROLES)), len(_PAIRS))
    for index, (some, others) in enumerate(_PAIRS):
        for a, b in product(some, others):
            table[ROLES.index(a), ROLES.index(b)] = table[ROLES.index(b), ROLES.index(a)] = index
    return table
