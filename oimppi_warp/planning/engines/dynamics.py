"""Interface between the optimizers and the models that they plan with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute, Launch
from oimppi_warp.config.settings import RobotCost, RobotLevel
from oimppi_warp.geometry.fields import Geometry, to_center
from oimppi_warp.geometry.kinematics import tip_frame
from oimppi_warp.kernels.geometry import PoseField
from oimppi_warp.observation import Observation
from oimppi_warp.planning.engines.packing import tip_bound, velocity_bound
from oimppi_warp.planning.engines.uncertainty import CERTAIN, Draws
from oimppi_warp.planning.upright import UprightModel
from oimppi_warp.scene import Scene


class Dynamics(Protocol):
    """A model that turns control sequences into costs, from a state that it keeps.

    Attributes:
        size: Number m of entries of one control.
        bound: Largest magnitude of each entry, shape [m], in the unit of the controls.
        compute: Device, and number of CPU threads.
    """

    size: int
    bound: np.ndarray
    compute: Compute

    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the cost of each control sequence, from the state that is set when it runs.

        It rolls out and evaluates S: lines 5 and 6 of Algorithm 1.

        Args:
            controls: [sample, horizon] of vectors, one number per control.
            costs: [sample], written.
        """
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class RolloutTask:
    """Everything that a robot level engine is built from.

    Attributes:
        scene: The task.
        geometry: Limit surface and distance fields of the scene.
        level: Settings of the robot level.
        cost: Cost weights of the robot level.
        dt: Control period [s].
        compute: Device, and number of CPU threads.
        draws: Random draws of friction, mass, perceived pose and tool offset for the rollouts.
        to_go: Cost-to-go of the object [m]; ``None`` if its weight is zero.
        yaw_length: Length that a radian of yaw counts as in the cost-to-go [m].
        upright: The arm with its tool upright; ``None`` if the controls are joint velocities.
    """

    scene: Scene
    geometry: Geometry
    level: RobotLevel
    cost: RobotCost
    dt: float
    compute: Compute
    draws: Draws = CERTAIN
    to_go: PoseField | None = None
    yaw_length: float = 1.0
    upright: UprightModel | None = None

    def __post_init__(self) -> None:
        if self.cost.w_to_go > 0.0 and self.to_go is None:
            raise ValueError("cost.w_to_go is positive: to_go is needed")


@dataclass(frozen=True, eq=False)
class Trace:
    """Predicted outcome of a control sequence.

    Attributes:
        tips: Positions of the tool tip in the world frame, shape [horizon + 1, 3] [m].
        poses: Planar poses of the object's friction centre, shape [horizon + 1, 3] [m, m, rad].
        terms: Weighted cost terms summed over the horizon, in the order of the engine's ``terms``.
    """

    tips: np.ndarray
    poses: np.ndarray
    terms: np.ndarray


class RobotDynamics(ABC):
    """A rollout engine of the robot level; controls are joint velocities [rad/s].

    With ``robot.controls=tool``, the planner converts the sampled velocities of the tip to joint velocities, unless the
    engine takes them itself (``takes_tip_velocities``); then these are its controls [m/s].

    An engine must define :meth:`rollout`, which starts from :attr:`observation` and :attr:`goal` or from what
    :meth:`set_state` derives from them. Everything else is optional. :meth:`trace`, :meth:`traced` and :meth:`paths`
    serve logs and the viewer; those of this class report the cost of a plan, and show arm and object at rest. An engine
    may ignore ``waypoint``; repositioning then has no effect with it.

    Engines are entries of :data:`oimppi_warp.registries.ENGINES`: a subclass, or any callable that takes a
    :class:`RolloutTask` and returns an instance of one.

    Args:
        task: The task to plan.

    Attributes:
        known_success: Success rate from 0 to 1 of each method with this engine in a benchmark, by the method's name.
            ``--engine auto`` takes only engines whose success rate is known for the method.
        slower_than: Names of engines whose plans are known to take less time. ``--engine auto`` does not try this
            engine if one of those is too slow.
        takes_tip_velocities: Whether the engine takes velocities of the tip with ``robot.controls=tool``.
        one_graph: Whether the launches of the engine can be captured in a CUDA graph.
        terms: Names of the cost terms.
        task: The task to plan.
        upright: The arm with its tool upright, if the controls are velocities of the tip; else ``None``.
        size: Number of entries of a control: that of joints (dof), or 3.
        bound: Largest magnitude of each entry to plan with, shape [size]: [rad/s; m/s for a prismatic joint], or [m/s].
        compute: Device, and number of CPU threads.
        reference: Desired poses of the object's friction centre at each step from now, an input of the step
            (:class:`oimppi_warp.compute.step.Compute`), [horizon + 1 + align_ahead].
        waypoint: Waypoint of the tip while it is repositioned, an input [1] of (x, y, z [m], weight [1/m^2]).
        observation: The state to plan from.
        goal: The goal of the object's friction centre, shape [3] [m, m, rad].
    """

    known_success: ClassVar[Mapping[str, float]] = {}
    slower_than: ClassVar[frozenset[str]] = frozenset()
    takes_tip_velocities: ClassVar[bool] = False
    one_graph: bool = False
    terms: tuple[str, ...] = ("cost",)
    observation: Observation
    goal: np.ndarray

    def __init__(self, task: RolloutTask) -> None:
        self.task = task
        self.compute = task.compute
        self.upright = task.upright if self.takes_tip_velocities else None
        if self.upright is None:
            self.bound = velocity_bound(task.scene, task.level)
        else:
            self.bound = tip_bound(task.level)
        self.size = len(self.bound)
        self.reference = task.compute.input(task.level.optimizer.horizon + 1 + task.cost.align_ahead, wp.vec3)
        self.waypoint = task.compute.input(1, wp.vec4)
        self._costs: wp.array | None = None

    @abstractmethod
    def rollout(self, controls: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the cost of each joint velocity sequence; see :class:`Dynamics`.

        An engine in NumPy returns a function that reads ``controls.numpy()``, shape [sample, horizon, dof], and ends
        with ``costs.assign(...)``.

        Args:
            controls: [sample, horizon] of vectors [dof] [rad/s].
            costs: [sample], written.
        """

    def set_state(self, observation: Observation, goal: np.ndarray) -> None:
        """Sets the state to plan from, and the goal of the object's friction centre, shape [3] [m, m, rad]."""
        self.observation, self.goal = observation, goal

    def trace(self, nominal: wp.array, costs: wp.array) -> Launch:
        """Returns a launch that writes the data that :meth:`traced` reads, after an update.

        Args:
            nominal: The updated nominal, [horizon] of vectors.
            costs: Costs of the samples that it was made from, [sample].
        """
        self._costs = costs
        return lambda: None

    def check(self) -> None:  # noqa: B027
        """Raises an error if the latest rollouts cannot be used; called in each plan before its command is."""

    def traced(self) -> Trace:
        """Returns the plan's trace: that of the nominal, or of the best sample where another rollout would be costly.

        This base implementation repeats the current state, and gives the cost of the cheapest sample as the only term.
        """
        assert self._costs is not None, "call trace() first"
        steps = self.task.level.optimizer.horizon + 1
        pose = to_center(self.task.geometry.surface, self.observation.object_pose)
        least = self._costs.numpy().min()
        return Trace(np.tile(self._tip(), (steps, 1)), np.tile(pose, (steps, 1)), np.array([least], dtype=float))

    def paths(self, controls: wp.array, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the traces of some samples of the latest rollout, for display.

        Args:
            controls: The controls that were rolled out, [sample, horizon] of vectors.
            samples: Indices of the samples, shape [n].

        Returns:
            Tool tips, shape [n, steps, 3] [m], and weighted cost terms, shape [n, terms]. ``steps`` is horizon + 1, or
            horizon in an engine that leaves out the current tip. This base implementation repeats the current tip and
            gives the total cost as the only term.
        """
        assert self._costs is not None, "call trace() first"
        tips = np.tile(self._tip(), (len(samples), controls.shape[1] + 1, 1))
        return tips, self._costs.numpy()[samples][:, None]

    def _tip(self) -> np.ndarray:
        """Returns the tool's tip in the state to plan from, shape [3] [m]."""
        return tip_frame(self.task.scene.robot, self.observation.joint_position)[1]


def control_type(size: int) -> type:
    """Returns Warp's vector type for controls of ``size`` numbers (the same object that the kernels use)."""
    return wp.types.vector(length=size, dtype=float)
