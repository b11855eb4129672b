"""The robot level, common to all methods: a motion of the arm that makes the object follow a reference.

Alone it is plain MPPI, whose reference is the goal.
"""

from __future__ import annotations

import math
import time
from functools import cached_property, partial
from weakref import ref

import numpy as np
import warp as wp

from oimppi_warp.compute.step import Compute, Launch, Step, using_gpu
from oimppi_warp.config.settings import Config
from oimppi_warp.errors import ObservationError
from oimppi_warp.geometry.fields import build_geometry, from_center, to_center
from oimppi_warp.geometry.kinematics import tip_frame, tip_jacobian
from oimppi_warp.geometry.reach import can_lift
from oimppi_warp.kernels.detour import take_detour
from oimppi_warp.kernels.upright_step import allowed_velocity
from oimppi_warp.observation import Observation, check_shapes, implausible, planar_transform
from oimppi_warp.planning.cost_to_go import build_to_go, to_go_at
from oimppi_warp.planning.diagnosis import why_lost
from oimppi_warp.planning.engines.dynamics import RobotDynamics, RolloutTask
from oimppi_warp.planning.engines.factory import make_dynamics
from oimppi_warp.planning.engines.packing import environment, object_model, velocity_bound
from oimppi_warp.planning.engines.tip_controls import TipControls
from oimppi_warp.planning.engines.uncertainty import draw
from oimppi_warp.planning.object_level import distance
from oimppi_warp.planning.optimizers.optimizer import Update, make_optimizer
from oimppi_warp.planning.plan import Later, Plan, PlanDetails, Samples
from oimppi_warp.planning.progress import poses_at
from oimppi_warp.planning.reposition import Repositioner
from oimppi_warp.planning.upright import TipRates, ToolServo, build_upright
from oimppi_warp.scene import Scene

_DAMPING = 0.05
"""Damping of the Jacobian's pseudo-inverse: singular values below it are not inverted [m/rad]."""


_FINER = 4
"""Contact steps of the first control on the arm, per contact step in the rollouts."""


class Planner:
    """Plain MPPI, and the base of the methods that plan the object's motion.

    It solves ``min over u_r of sum_h l_o(x_o) + l_r(x_r) + l_c(x_o, x_o*)`` with the coupling cost
    ``l_c = d^2(x_o, x_o*)`` of object and reference (equation 14), and plain MPPI ``min over u_r of sum_h l_o + l_r``
    (equation 8); both without the terminal cost l_f. A rollout engine predicts the outcome of the controls.

    A control step (:meth:`plan`) writes the inputs, runs steps on the device (:meth:`Compute.step`) and reads the
    outputs: the two levels; the first command as the arm may follow it; the trace of the nominal. :meth:`tracked` and
    :meth:`object_statistics` are called once more when a plan's details are read, which may be in another thread and at
    the beginning of the next plan or episode. While an object that made no headway is pushed from elsewhere, the push
    takes the reference's place; plain MPPI, whose cost does not count the reference, only takes the tool there.

    A method is a subclass that provides the reference. It overrides :meth:`set_reference`, and :meth:`start`,
    :meth:`tracked`, :meth:`to_go_from`, :meth:`to_goal_from`, :meth:`object_statistics` and :meth:`object_finished` if
    needed; the launches of a step before the robot level go into ``object_launches`` in its constructor. It is
    registered in :data:`oimppi_warp.registries.METHODS`.

    Args:
        scene: The task.
        config: All settings, resolved for the scene (:func:`oimppi_warp.planning.resolve.resolve`).
        engine: Rollout engine of the robot level.
        compute: The device and its threads.
        seed: Seed of all noise; the same seed gives the same plans (on the CPU to the bit).

    Attributes:
        engine: Name of the rollout engine.
        engine_reason: Reason for its choice, if it was not requested by name.
        geometry: Shapes of the scene.
        goal: The scene's goal, of the friction centre.
        dynamics: The engine.
        optimizer: The robot level's optimizer.
        pace: Number of steps along the reference per control step, an input [1]; less than 1 while the object makes no
            headway.
        object_launches: Launches of a step before the robot level; complete before the first plan.
        object_one_graph: Whether these can be captured in a CUDA graph.
        object_plan: The object plan made at the start, poses [n, 3] of the object's frame; ``None`` if the method makes
            none.
    """

    method: str = "mppi"
    object_plan: np.ndarray | None = None
    object_one_graph: bool = True

    def __init__(self, scene: Scene, config: Config, *, engine: str, compute: Compute, seed: int) -> None:
        self.scene = scene
        self.config = config
        self.engine = engine
        self.engine_reason = ""
        self.compute = compute
        self.geometry = build_geometry(scene, compute.device, threads=compute.threads)
        self.goal = to_center(self.geometry.surface, np.array(scene.goal))
        level = config.robot
        draws = draw(level.uncertainty, samples=level.optimizer.samples, seed=seed)
        to_go = None
        self._to_go_values = np.zeros(0)
        began = time.perf_counter()
        if config.cost.w_to_go > 0.0:
            to_go = build_to_go(
                self.geometry.clearance,
                self.goal,
                yaw_length=config.object.yaw_length,
                push_ring=config.object_cost.push_ring,
                device=compute.device,
            )
            self._to_go_values = to_go.values.numpy()
        self._to_go = to_go
        self._setup_seconds = time.perf_counter() - began
        height, limits = config.cost.height, velocity_bound(scene, level)
        upright = None
        self._servo = None
        if level.controls == "tool":
            around = environment(scene, self.geometry, config.cost)
            upright = build_upright(
                scene,
                self.geometry,
                around,
                level,
                limits=limits,
                most_change=config.safety.most_change(config.control_period),
                height=height,
                device=compute.device,
            )
            self._servo = ToolServo(scene.robot, limits=limits, period=config.control_period)
        self.dynamics = make_dynamics(
            engine,
            RolloutTask(
                scene=scene,
                geometry=self.geometry,
                level=level,
                cost=config.cost,
                dt=config.control_period,
                compute=compute,
                draws=draws,
                to_go=to_go,
                yaw_length=config.object.yaw_length,
                upright=upright,
            ),
        )
        self._rollouts: RobotDynamics | TipControls = self.dynamics
        if upright is not None and not self.dynamics.takes_tip_velocities:
            self._rollouts = TipControls(self.dynamics)
        self.optimizer = make_optimizer(self._rollouts, level.optimizer, seed=2 * seed + 1)
        self.object_launches: list[Launch] = []
        nominal = self.optimizer.nominal
        followed = wp.empty_like(nominal)
        self._robot_launches = [
            *self.optimizer.improve,
            lambda: wp.copy(followed, nominal),
            self.optimizer.shift,
        ]
        self._trace_launches = [self._rollouts.trace(followed, self.optimizer.costs)]
        self._command_launches: list[Launch] = []
        reference = self.dynamics.reference
        self._detour = compute.input(len(reference.host), wp.vec3)
        self._on_detour = compute.input(1, int)
        self._detour_launch = compute.launch(
            take_detour, len(reference.host), [self._detour.array, self._on_detour.array], [reference.array]
        )
        self.pace = compute.input(1, float)
        self.pace.host[0] = 1.0
        # The command's step has its own inputs and outputs: they are written while the step before it runs.
        self._late = Compute(compute.name, threads=compute.threads)
        self._start = self._late.input(3, wp.vec3)  # the tip's position, the object's pose, the tip's velocity
        self._rates = self._late.input(scene.robot.dof, wp.vec3)  # joint velocities per velocity of the tip
        self._allowed = self._late.output(1, wp.vec3)
        if upright is not None:
            model = object_model(self.geometry, tool_friction=scene.object.tool_friction)
            most = config.safety.most_change(config.control_period)
            inputs = [upright.packed, model, scene.robot.tool_radius, self._start.array, self._rates.array, most]
            inputs += [self.dynamics.waypoint.array, self.optimizer.command.array, config.control_period]
            inputs += [_FINER * level.contact_steps]
            self._command_launches.append(self._late.launch(allowed_velocity, 1, inputs, [self._allowed.array]))
        self._repositioner = Repositioner(
            scene,
            self.geometry,
            config.reposition,
            w_theta=config.cost.w_theta,
            height=height,
            period=config.control_period,
            arm_clearance=None if upright is None else upright.clearance_at,
        )
        self._tracked = self.goal[None]
        self._latest: ref[Later] | None = None  # weak: it refers to this planner

    @cached_property
    def steps(self) -> tuple[Step, Step, Step]:
        """Returns the steps of a plan: both levels; the command as the arm may follow it; the trace of the nominal."""
        levels = [*self.object_launches, self._detour_launch, *self._robot_launches]
        self.compute.load([*levels, *self._command_launches, *self._trace_launches])
        captured = self.dynamics.one_graph and self.optimizer.one_graph and self.object_one_graph
        return (
            self.compute.step(levels, one_graph=captured),
            self._late.step(self._command_launches),
            self.compute.step(self._trace_launches, one_graph=self.dynamics.one_graph, upload=False),
        )

    @property
    def repositioning(self) -> bool:
        """Returns whether the tool is being moved to another place at the object."""
        return bool(self.dynamics.waypoint.host[0][3] > 0.0)

    @property
    def on_detour(self) -> bool:
        """Returns whether the object is led along a push of its own instead of the method's reference."""
        return bool(self._on_detour.host[0])

    def warm_up(self) -> None:
        """Compiles and loads every kernel, so that the first plan is as fast as the others."""
        self.rehearse()

    def rehearse(self) -> None:
        """Plans once from the task's start and discards the plan."""
        start = np.array(self.scene.start)
        joints = self.scene.robot.start
        transform = planar_transform(self.scene.start, self.scene.object.rest_height)
        self.plan(Observation(0.0, joints, np.zeros_like(joints), start, transform)).details()

    def start(self, observation: Observation) -> float:
        """Prepares for an episode that begins with ``observation``.

        Returns:
            Wall time of planning and of computing the cost-to-go before the first control step [s].

        Raises:
            ObservationError: An array has the wrong length, or the observation is implausible.
        """
        check_shapes(observation, self.scene.robot.dof)
        if problem := implausible(observation, self.scene.robot):
            raise ObservationError(f"an episode cannot start from this observation: {problem}")
        self._settle()
        self.optimizer.reset()
        self._repositioner.reset()
        return self._setup_seconds

    def plan(self, observation: Observation) -> Plan:
        """Plans from an observation; each call is one control step.

        It is one pass through Algorithm 2, lines 2 to 7, or Algorithm 3, lines 11 to 13.

        From an implausible observation (numbers that are not finite, an object far away, joints far beyond their
        limits) nothing is planned, and if no sample has a finite cost, nothing is found: the command is zero, and
        :attr:`Plan.problem` gives the reason.

        Raises:
            ObservationError: An array has the wrong length.
        """
        check_shapes(observation, self.scene.robot.dof)
        if problem := implausible(observation, self.scene.robot):
            return self._stop(problem)
        self._settle()
        pose = to_center(self.geometry.surface, observation.object_pose)
        tip = tip_frame(self.scene.robot, observation.joint_position)[1]
        waypoint = self._repositioner.waypoint(tip, pose, self.to_go_from, self.to_goal_from)
        self.dynamics.waypoint.host[0] = waypoint
        detour = self._repositioner.detour(len(self._detour.host))
        self._on_detour.host[0] = detour is not None
        if detour is not None:
            self._detour.host[:] = detour
        self.pace.host[0] = self._repositioner.pace
        self._rollouts.set_state(observation, self.goal)
        repositioning = bool(waypoint[3] > 0.0)
        self.optimizer.noise.host[0] = self._noise(observation.joint_position, repositioning=repositioning)
        self.set_reference(pose)
        levels, command, trace = self.steps
        began = time.perf_counter()
        levels.begin()
        rates = None
        if self._servo is not None:  # meanwhile, a GPU plans
            rates = self._servo.rates(observation.joint_position)
            self._rates.host[:] = rates.follow
            self._start.host[:] = tip, pose, rates.linear @ observation.joint_velocity
            command.begin()
        levels.wait()
        self.dynamics.check()
        trace.begin()
        details = Later(partial(self._details, detour))
        self._latest = ref(details)
        if self.optimizer.found().lost >= self.optimizer.settings.samples:
            return Plan(
                np.zeros(self.scene.robot.dof), self.object_finished() - began, details, why_lost(self, self._rollouts)
            )
        return Plan(self._command(rates), self.object_finished() - began, details)

    def _settle(self) -> None:
        """Fetches the details of the latest plan, which the next one overwrites, if somebody still has that plan."""
        latest, self._latest = self._latest, None
        details = None if latest is None else latest()
        if details is not None:
            details()

    def _details(self, detour: np.ndarray | None) -> PlanDetails:
        """Returns the details of the latest plan, made with the method's own reference or a detour, shape [n, 3]."""
        with using_gpu:
            self.steps[-1].wait()
            trace = self.dynamics.traced()
            surface = self.geometry.surface
            return PlanDetails(
                update=self.optimizer.found(),
                object_update=self.object_statistics(),
                terms=trace.terms,
                tips=trace.tips,
                object_poses=from_center(surface, trace.poses),
                reference=from_center(surface, self.tracked() if detour is None else detour),
            )

    def samples(self, count: int) -> Samples:
        """Returns samples of the latest plan for display, sorted by decreasing weight.

        Half of them are those with the largest weights; the others are spread evenly over the rest.

        Args:
            count: Number of samples.
        """
        with using_gpu:
            weights = self.optimizer.weights.numpy()
            heaviest = np.argsort(-weights, kind="stable")
            half = count // 2
            others = heaviest[half :: max((len(heaviest) - half) // (count - half), 1)]
            chosen = np.concatenate([heaviest[:half], others])
            tips, terms = self._rollouts.paths(self.optimizer.controls, chosen[:count])
        shares = weights[chosen[:count]] / max(float(weights.max()), 1e-30)
        return Samples(tips, shares, dict(zip(self.dynamics.terms, terms[0].tolist(), strict=True)))

    def _stop(self, problem: str) -> Plan:
        """Returns a plan that stops the arm."""
        details = PlanDetails(
            update=Update(min_cost=math.nan, temperature=math.nan, effective_samples=math.nan, lost=0),
            object_update=None,
            terms=np.full(len(self.dynamics.terms), math.nan),
            tips=np.zeros((0, 3)),
            object_poses=np.zeros((0, 3)),
            reference=np.zeros((0, 3)),
        )
        return Plan(np.zeros(self.scene.robot.dof), math.nan, lambda: details, problem)

    def set_reference(self, pose: np.ndarray) -> None:
        """Sets the reference of the next plan, given the pose of the friction centre, shape [3] [m, m, rad]."""
        self.track(self.goal[None])

    def track(self, reference: np.ndarray) -> None:
        """Sets the reference of the robot level, at the present pace; beyond its end, the last pose is held.

        Args:
            reference: Planar poses of the object's friction centre, one per control step, shape [n, 3] [m, m, rad].
        """
        host = self.dynamics.reference.host
        self._tracked = reference
        host[:] = poses_at(reference, np.minimum(self.pace.host[0] * np.arange(len(host)), len(reference) - 1.0))

    def tracked(self) -> np.ndarray:
        """Returns the reference of the latest step, before it was slowed down to the present pace.

        It consists of planar poses of the friction centre, shape [n, 3] [m, m, rad].
        """
        return self._tracked

    def to_go_from(self, pose: np.ndarray) -> float:
        """Returns the distance [m] that the object still has to travel from a planar pose, shape [3] [m, m, rad].

        A radian of yaw counts as the setting ``object.yaw_length``.
        """
        if self._to_go is not None:
            return to_go_at(self._to_go, self._to_go_values, pose, self.goal, self.config.object.yaw_length)
        return distance(pose, self.goal, self.config.object.yaw_length)

    def to_goal_from(self, pose: np.ndarray) -> float:
        """Returns the same distance [m], without regard to a plan that the object follows."""
        return self.to_go_from(pose)

    def object_statistics(self) -> Update | None:
        """Returns the statistics of the object level's update in the latest step; ``None`` if it did not plan."""
        return None

    def object_finished(self) -> float:
        """Returns the ``time.perf_counter`` at which the object level finished the latest step; NaN if unknown."""
        return math.nan

    def _command(self, rates: TipRates | None) -> np.ndarray:
        """Returns the joint velocities of the first control of the updated nominal, shape [dof] [rad/s].

        ``rates`` are those of the tip at the present joint positions; ``None`` if the controls are joint velocities.
        """
        if self._servo is None or rates is None:
            return self.optimizer.command.host[0].astype(float)
        return self._servo.joint_velocity(rates, self._allowed.host[0].astype(float))

    def _noise(self, joints: np.ndarray, *, repositioning: bool = False) -> np.ndarray:
        """Returns a square root of the noise's covariance: ``root root^T = Sigma_u`` (equation 9).

        Its shape is [dof, dof] in the space of the joints, and [3, 3] in that of the tip.
        """
        robot = self.config.robot
        if robot.controls == "tool":
            return robot.tip_noise * np.diag([1.0, 1.0, float(repositioning and can_lift(self.scene.robot))])
        if robot.noise_space == "joint":
            return robot.joint_noise * np.eye(self.scene.robot.dof)
        jacobian = tip_jacobian(self.scene.robot, joints)
        inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + _DAMPING**2 * np.eye(6))
        noise = np.array(robot.tool_noise)
        if repositioning:  # as much noise vertically as sideways
            noise[2] = max(noise[:3])
        root = inverse * noise
        if root.shape[0] != root.shape[1]:
            root = np.linalg.cholesky(root @ root.T + 1e-8 * np.eye(len(root)))
        return root
